"""What real data does to a rasterizer, one named scene each."""

from dataclasses import replace

import torch

from tests.support.gaussians import Scene, make_scene


def edge_case_scenes() -> dict[str, Scene]:
    return _ordinary() | _features() | _corners()


def _ordinary() -> dict[str, Scene]:
    plain = make_scene(30)
    return {
        "plain": plain,
        "no background": replace(plain, backgrounds=None),
        "more in a tile than a batch": make_scene(300, 18, 17, scale=(0.02, 0.2), opacity=(0.01, 0.2), seed=5),
        "behind the camera": make_scene(40, depth=(-4.0, 5.0), seed=3),
        "empty tiles": make_scene(6, 70, 50, spread=0.1, scale=(0.01, 0.05), seed=7),
        "far outside": make_scene(30, spread=4.0, scale=(0.2, 1.0), seed=8),
        "17 x 33": make_scene(30, 17, 33, seed=12),
        "one pixel": make_scene(5, 1, 1, scale=(0.5, 1.5), seed=9),
    }


def _features() -> dict[str, Scene]:
    masked = make_scene(30, cameras=2, seed=13)
    checks = torch.arange(2 * masked.height * masked.width).view(2, masked.height, masked.width) % 3 > 0
    return {
        "sh 3 of 3, two cameras": make_scene(20, cameras=2, sh_coeffs=16, sh_degree=3, seed=1),
        "sh 1 of 3": make_scene(20, sh_coeffs=16, sh_degree=1, seed=2),
        "sh 0": make_scene(20, sh_coeffs=1, sh_degree=0, seed=2),
        "one channel": make_scene(20, channels=1, seed=14),
        "32 channels": make_scene(20, channels=32, seed=15),
        "antialiased": make_scene(30, scale=(0.005, 0.1), antialiased=True, seed=4),
        "median depth": make_scene(60, median_depth=True, seed=16),
        "absolute gradients": make_scene(60, absgrad=True, seed=17),
        "masked": replace(masked, masks=checks),
        "all masked": replace(masked, masks=torch.zeros_like(checks)),
    }


def _corners() -> dict[str, Scene]:
    plain = make_scene(30)
    level = plain.means.clone()
    level[:, 2] = 3.0
    ahead = torch.eye(4, dtype=torch.float64)[None]
    at_center = plain.means.clone()
    at_center[::4] = 0  # of a camera at the world's origin
    mixed = _every_third(plain.opacities, 0.0)
    mixed[1::3] = 1.0
    needles = _every_third(plain.scales, torch.tensor([0.0, 0.0, 0.5]))
    return {
        "saturated": make_scene(60, scale=(0.5, 1.5), opacity=(1.0, 1.0), seed=6),
        "equal depths": replace(plain, means=level, viewmats=ahead),
        "zero quaternions": replace(plain, quats=_every_third(plain.quats, 0.0)),
        "zero scale, one axis": replace(plain, scales=_every_third(plain.scales, torch.tensor([0.3, 0.0, 0.2]))),
        "zero scale, two axes": replace(plain, scales=needles),
        "zero scale, all axes": replace(plain, scales=_every_third(plain.scales, 0.0)),
        "zero scale, all axes, antialiased": replace(
            plain, scales=_every_third(plain.scales, 0.0), options={"antialiased": True}
        ),
        "no blur": replace(plain, options={"eps2d": 0.0}),
        "opacity 0 and 1": replace(plain, opacities=mixed),
        "opacity 0": replace(plain, opacities=torch.zeros_like(plain.opacities)),
        "at the camera's centre": replace(plain, means=at_center, viewmats=ahead),
        "enormous": replace(plain, scales=_every_third(plain.scales, 1e3), opacities=0.3 * plain.opacities),
        "sub-pixel": make_scene(60, scale=(1e-6, 1e-3), seed=18),
        "nothing visible": make_scene(5, depth=(-4.0, -2.0), seed=10),
        "nothing at all": make_scene(0),
    }


def _every_third(values: torch.Tensor, value: float | torch.Tensor) -> torch.Tensor:
    changed = values.clone()
    changed[::3] = torch.as_tensor(value).to(values)
    return changed
