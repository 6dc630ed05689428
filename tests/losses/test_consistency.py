"""Reprojection on analytic scenes, and the consistency losses against their float64 twin."""

import dataclasses

import pytest
import torch

import graphgs.threads
from graphgs.losses import consistency_loss, reproject
from tests.support.reference import reproject as twin

SIZE_I, SIZE_J = (60, 80), (66, 90)  # height, width
K_I = torch.tensor([[70.0, 0, 40.3], [0, 72, 29.1], [0, 0, 1]], dtype=torch.float64)
K_J = torch.tensor([[75.0, 0, 44.2], [0, 74, 34.0], [0, 0, 1]], dtype=torch.float64)


def rigid(rotation_vector, translation):  # [4, 4]
    pose = torch.eye(4, dtype=torch.float64)
    x, y, z = rotation_vector
    pose[:3, :3] = torch.linalg.matrix_exp(torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64))
    pose[:3, 3] = torch.tensor(translation, dtype=torch.float64)
    return pose


POSE = rigid((0.02, -0.08, 0.05), (0.3, -0.1, 0.2))  # cam_j_from_cam_i


def rays(K, size):  # [H, W, 3], z = 1
    pixels = twin.pixel_centres(*size)
    return torch.cat([pixels, torch.ones_like(pixels[..., :1])], dim=-1) @ torch.linalg.inv(K).T


def plane_depth(normal, distance, K, size, cam_from_i):  # of the plane normal . X = distance in camera i
    rotation, translation = cam_from_i[:3, :3], cam_from_i[:3, 3]
    turned = rotation @ normal
    return (distance + turned @ translation) / (rays(K, size) @ turned)


NORMAL, DISTANCE = torch.tensor([0.2, -0.1, 1.0], dtype=torch.float64), 4.0
IDENTITY = torch.eye(4, dtype=torch.float64)


def sphere_depth(center, radius, K, size):  # nearest hit, 0 where the ray misses
    directions = rays(K, size)
    a = (directions**2).sum(-1)
    b = directions @ center
    root = b**2 - a * (center @ center - radius**2)
    return torch.where(root > 0, (b - root.clamp(min=0).sqrt()) / a, torch.zeros_like(b))


@dataclasses.dataclass
class Scene:
    """The plane seen by both cameras, with a texture that is linear in the pixel coordinates of image j."""

    image_i: torch.Tensor  # [H, W, 3]
    depth_i: torch.Tensor  # [H, W, 1]
    alpha_i: torch.Tensor
    image_j: torch.Tensor
    depth_j: torch.Tensor
    K_i: torch.Tensor
    K_j: torch.Tensor
    cam_j_from_cam_i: torch.Tensor

    def to(self, device, dtype):
        return Scene(**{name: tensor.to(device, dtype) for name, tensor in vars(self).items()})

    def loss(self, mode="graphgs", **options):
        return consistency_loss(**vars(self), mode=mode, **options)

    def reprojection(self, **options):
        return reproject(self.depth_i, self.alpha_i, self.depth_j, self.K_i, self.K_j, self.cam_j_from_cam_i, **options)

    def twin_loss(self, mode="graphgs"):
        flat = {name: t[..., 0] if name in ("depth_i", "alpha_i", "depth_j") else t for name, t in vars(self).items()}
        return twin.consistency_loss(**flat, mode=mode)


def linear_texture(pixels):  # [..., 2] -> [..., 3], within 0..1 on image j
    weights = torch.tensor([[0.008, 0.002], [-0.006, 0.009], [0.003, -0.007]], dtype=torch.float64)
    return pixels @ weights.T + torch.tensor([0.1, 0.3, 0.5], dtype=torch.float64)


@pytest.fixture
def scene():
    depth_i = plane_depth(NORMAL, DISTANCE, K_I, SIZE_I, IDENTITY)
    coords, _ = twin.reproject(depth_i, K_I, K_J, POSE)
    return Scene(
        image_i=linear_texture(coords),
        depth_i=depth_i[..., None],
        alpha_i=torch.ones_like(depth_i)[..., None],
        image_j=linear_texture(twin.pixel_centres(*SIZE_J)),
        depth_j=plane_depth(NORMAL, DISTANCE, K_J, SIZE_J, POSE)[..., None],
        K_i=K_I,
        K_j=K_J,
        cam_j_from_cam_i=POSE,
    )


@pytest.fixture
def noisy_scene(scene):
    """Colours that disagree everywhere, and every kind of pixel without a match."""
    generator = torch.Generator().manual_seed(4)
    scene.image_i = torch.rand(scene.image_i.shape, generator=generator, dtype=torch.float64)
    scene.image_j = torch.rand(scene.image_j.shape, generator=generator, dtype=torch.float64)
    scene.alpha_i[5:9, 20:30] = 0.3
    scene.depth_i[10:14, 20:30] = 0.0
    scene.depth_i[15:17, 20:30] = -2.0
    scene.depth_i[18:22, 20:30] *= 1.2  # the backward check fails
    scene.depth_j[40:45, 30:45] = 0.0
    scene.depth_j[30:36, 50:60] *= 0.7  # an occluder
    return scene


def test_a_plane_reprojects_by_its_homography(scene, device):
    out = scene.to(device, torch.float32).reprojection()
    homography = K_J @ (POSE[:3, :3] + POSE[:3, 3:] @ NORMAL[None] / DISTANCE) @ torch.linalg.inv(K_I)
    pixels = twin.pixel_centres(*SIZE_I)
    moved = torch.cat([pixels, torch.ones_like(pixels[..., :1])], dim=-1) @ homography.T
    expected = moved[..., :2] / moved[..., 2:]
    assert float((out.coords[0].double().cpu() - expected).abs().max()) < 1e-3
    assert torch.equal(out.valid[0, ..., 0].cpu(), twin.inside(expected, *SIZE_J))
    assert 0.5 < float(out.valid.float().mean()) < 1.0


def test_a_sphere_reprojects_where_both_cameras_see_it(device):
    center, radius = torch.tensor([0.1, 0.0, 5.0], dtype=torch.float64), 1.5
    pose = rigid((0.0, 0.35, 0.0), (0.0, 0.0, 0.0))
    pose[:3, 3] = center - pose[:3, :3] @ center  # camera j on an arc around the sphere
    center_j = pose[:3, :3] @ center + pose[:3, 3]
    depth_i, depth_j = sphere_depth(center, radius, K_I, SIZE_I), sphere_depth(center_j, radius, K_J, SIZE_J)
    covered = (depth_i > 0).double()
    operands = (depth_i[..., None], covered[..., None], depth_j[..., None], K_I, K_J, pose)
    out = reproject(*(t.to(device, torch.float32) for t in operands))
    valid = out.valid[0, ..., 0].cpu()

    points_i = rays(K_I, SIZE_I) * depth_i[..., None]
    points_j = points_i @ pose[:3, :3].T + pose[:3, 3]
    projected = points_j @ K_J.T
    error = (out.coords[0].double().cpu() - projected[..., :2] / projected[..., 2:]).abs().amax(-1)
    assert float(error[covered > 0].max()) < 1e-3
    normals = (points_j - center_j) / radius
    cosines = -(normals * points_j).sum(-1) / points_j.norm(dim=-1)  # of the angle to camera j
    # Nearer the outline one of the four pixels around the landing point may miss the sphere; just behind it, the
    # hidden point lies within the depth tolerance (2 * 1.5 * 0.1 = 0.3 of 5) of the one that camera j sees.
    assert torch.all(valid[(covered > 0) & (cosines > 0.5)])
    assert not torch.any(valid[(covered == 0) | (cosines < -0.1)])
    assert torch.any((covered > 0) & (cosines < -0.1))


def test_what_an_occluder_hides_from_the_other_camera_has_no_match(device):
    """A square at depth 2 before a wall at depth 4, camera j moved to the right by 0.6."""
    K = torch.tensor([[70.0, 0, 40], [0, 70, 30], [0, 0, 1]], dtype=torch.float64)
    pose = rigid((0, 0, 0), (-0.6, 0, 0))

    def depths(offset):  # the square spans -0.4 .. 0.4 in world x and y; the camera stands at x = offset
        hits = 2.0 * rays(K, SIZE_I)
        square = ((hits[..., 0] + offset).abs() < 0.4) & (hits[..., 1].abs() < 0.4)
        return torch.where(square, 2.0, 4.0).double()

    depth_i, depth_j = depths(0.0), depths(0.6)
    operands = (depth_i[..., None], torch.ones_like(depth_i)[..., None], depth_j[..., None], K, K, pose)
    valid = reproject(*(t.to(device, torch.float32) for t in operands)).valid[0, ..., 0].cpu()
    wall = 4.0 * rays(K, SIZE_I)
    halfway = (wall[..., :2] + torch.tensor([0.6, 0.0])) / 2  # where the line of sight from camera j passes depth 2
    hidden = (depth_i == 4.0) & (halfway.abs() < 0.4).all(-1)
    clear = (depth_i == 4.0) & ((halfway.abs() > 0.45).any(-1)) & (wall[..., 0] > -1.5)
    assert hidden.sum() > 100
    assert not torch.any(valid[hidden])
    assert torch.all(valid[clear])


def test_a_linear_picture_of_a_plane_is_consistent(scene, device):
    exact = scene.to(device, torch.float32)
    assert float(exact.loss()) < 1e-7  # colours agree to 1e-6, and the robust L1 is quadratic there
    assert float(exact.loss(mode="paper")) > 1e-2  # its geometry holds at depth 1 only
    exact.depth_i *= 1.03
    assert float(exact.loss()) > 1e-4


@pytest.mark.parametrize("scale", [1e3, 1e-3])
def test_the_loss_does_not_depend_on_the_unit_of_length(noisy_scene, scale, device):
    scene = noisy_scene.to(device, torch.float32)
    loss, valid = scene.loss(), scene.reprojection().valid
    scene.depth_i *= scale
    scene.depth_j *= scale
    scene.cam_j_from_cam_i = scene.cam_j_from_cam_i.clone()
    scene.cam_j_from_cam_i[:3, 3] *= scale
    assert float(scene.loss()) == pytest.approx(float(loss), rel=1e-5)
    assert torch.equal(scene.reprojection().valid, valid)


@pytest.mark.parametrize("mode", ["graphgs", "paper"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_loss_and_gradients_agree_with_the_twin(noisy_scene, mode, dtype, device):
    if mode == "paper":
        noisy_scene.cam_j_from_cam_i = rigid((0.02, -0.05, 0.02), (0.05, -0.02, 0.04))
    scene = noisy_scene.to(device, dtype)
    results = []
    for one, loss in ((scene, scene.loss), (noisy_scene, noisy_scene.twin_loss)):
        one.image_i.requires_grad_()
        one.depth_i.requires_grad_()
        value = loss(mode=mode)
        value.backward()
        v_depth = one.depth_i.grad if one.depth_i.grad is not None else torch.zeros_like(one.depth_i)
        results.append([t.detach().double().cpu() for t in (value, one.image_i.grad, v_depth)])
    # float32 sees pixel coordinates near 100 to 1e-5 px, and this noise has slopes near 1 per px
    tolerance = 2e-4 if dtype == torch.float32 else 1e-12
    for got, expected in zip(*results, strict=True):
        assert float((got - expected).norm()) <= tolerance * float(expected.norm())
    assert (float(results[1][2].norm()) > 0) == (mode == "graphgs")


def test_gradcheck_in_float64(noisy_scene, device):
    scene = noisy_scene.to(device, torch.float64)
    window = (slice(20, 25), slice(24, 31))  # holds pixels with and without a match
    scene.image_i, scene.depth_i, scene.alpha_i = (t[window] for t in (scene.image_i, scene.depth_i, scene.alpha_i))
    scene.K_i = scene.K_i - torch.tensor([[0, 0, 24.0], [0, 0, 20], [0, 0, 0]], device=device)
    valid = scene.reprojection().valid
    assert 0 < int(valid.sum()) < valid.numel()

    def loss(image_i, depth_i):
        return dataclasses.replace(scene, image_i=image_i, depth_i=depth_i).loss()

    leaves = [t.detach().clone().requires_grad_() for t in (scene.image_i, scene.depth_i)]
    assert torch.autograd.gradcheck(loss, leaves)


def test_pixels_without_a_match_have_no_gradient(noisy_scene, device):
    scene = noisy_scene.to(device, torch.float32)
    scene.image_i.requires_grad_()
    scene.depth_i.requires_grad_()
    scene.loss().backward()
    unmatched = ~scene.reprojection().valid[0, ..., 0]
    assert unmatched.any()
    assert torch.all(scene.image_i.grad[unmatched] == 0)
    assert torch.all(scene.depth_i.grad[unmatched] == 0)
    assert torch.all(scene.image_i.grad[~unmatched].abs().sum(-1) > 0)


def test_nothing_matched_gives_zero(scene, device):
    scene = scene.to(device, torch.float32)
    scene.image_i.requires_grad_()
    scene.alpha_i.zero_()
    loss = scene.loss()
    loss.backward()
    assert float(loss.detach()) == 0.0
    assert torch.all(scene.image_i.grad == 0)


def test_several_pairs_are_averaged_over_their_matched_pixels(scene, noisy_scene, device):
    scenes = [s.to(device, torch.float32) for s in (noisy_scene, noisy_scene)]
    scenes[1] = dataclasses.replace(scenes[1], cam_j_from_cam_i=rigid((0, 0.1, 0), (0.1, 0, 0)).to(scenes[0].depth_i))
    batch = Scene(**{name: torch.stack([vars(s)[name] for s in scenes]) for name in vars(scene)})
    counts = [int(s.reprojection().valid.sum()) for s in scenes]
    assert min(counts) > 0
    expected = sum(n * float(s.loss()) for n, s in zip(counts, scenes, strict=True)) / sum(counts)
    assert float(batch.loss()) == pytest.approx(expected, rel=1e-6)


def test_the_photo_of_camera_j_may_be_8_bit(noisy_scene, device):
    scene = noisy_scene.to(device, torch.float32)
    photo = (scene.image_j * 255).round().to(torch.uint8)
    scene.image_j = photo
    loss = scene.loss()
    scene.image_j = photo.float() / 255
    assert torch.equal(loss, scene.loss())


def test_the_result_does_not_depend_on_the_number_of_threads(noisy_scene, monkeypatch):
    results = []
    for threads in (1, 2, 3):
        monkeypatch.setattr(graphgs.threads, "_num_threads", threads)
        scene = noisy_scene.to("cpu", torch.float32)
        scene.image_i.requires_grad_()
        scene.depth_i.requires_grad_()
        loss = scene.loss()
        loss.backward()
        results.append((loss.detach(), scene.image_i.grad, scene.depth_i.grad))
    assert all(torch.equal(a, b) for other in results[1:] for a, b in zip(results[0], other, strict=True))


def test_wrong_arguments_are_named(scene):
    scene = scene.to("cpu", torch.float32)
    with pytest.raises(ValueError, match="mode: expected 'graphgs' or 'paper', got 'plain'"):
        scene.loss(mode="plain")
    with pytest.raises(ValueError, match=r"depth_j: expected \[1, 66, 90, 1\] like its image, got \[1, 60, 80, 1\]"):
        dataclasses.replace(scene, depth_j=scene.depth_i).loss()
    with pytest.raises(ValueError, match="expected 1 pair"):
        dataclasses.replace(scene, K_j=scene.K_j.expand(2, 3, 3)).loss()
    with pytest.raises(ValueError, match="image_i: expected float32 or float64"):
        dataclasses.replace(scene, image_i=scene.image_i.half()).loss()
