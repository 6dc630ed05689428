"""The rasterizer's stages one by one: project and shade, bin, composite forward and backward."""

import torch
import warp as wp

from bench import threads
from bench.metrics import Metric
from bench.rasterize import Work
from bench.scenes import scene
from bench.timing import median_time, time_metrics
from graphgs.kernels.rasterize.buffers import Frame, Splats
from graphgs.kernels.rasterize.tile_lists import list_tiles
from graphgs.rendering.bridge import scalars, vectors
from graphgs.rendering.composite import Composite, CompositeOptions
from graphgs.rendering.functions import Project, ProjectOptions, Shade
from graphgs.threads import get_num_threads

SIZES = ("2k", "10k", "50k", "500k")  # the last at 1920 x 1080


def run(device: str) -> list[Metric]:
    metrics = []
    for name in SIZES:
        work = Work.on(device, scene(name))
        for count in threads.counts(device):
            with threads.use_threads(count):
                repeats = 3 if name == "500k" else 15
                metrics += stages(f"stages/{name}/{threads.label(count)}", work, device, repeats=repeats)
    return metrics


def stages(key: str, work: Work, device: str, *, repeats: int) -> list[Metric]:
    load = work.scene
    means, quats, scales, opacities, sh_coeffs = work.leaves
    pinholes = torch.stack([work.Ks[:, 0, 0], work.Ks[:, 1, 1], work.Ks[:, 0, 2], work.Ks[:, 1, 2]], dim=-1)
    centers = -(work.viewmats[:, :3, :3] * work.viewmats[:, :3, 3:]).sum(dim=1)
    shape = "tiles" if device == "cpu" else "gpu"
    options = ProjectOptions(
        load.width, load.height, near=0.01, far=1e10, eps2d=0.3, antialiased=False, lanes=shape == "tiles"
    )
    background = means.new_zeros(1, 3)
    composite = CompositeOptions(load.width, load.height, median_depth=False, absgrad=False, shape=shape)

    def project() -> list[torch.Tensor]:
        return list(Project.apply(means, quats, scales, opacities, work.viewmats, pinholes, options))

    def shade(radii: torch.Tensor) -> torch.Tensor:
        return Shade.apply(means, sh_coeffs, centers, radii, 3)

    *splats, radii = project()
    colors = shade(radii)
    splats = [tensor.detach().requires_grad_() for tensor in (*splats, colors)]

    def blend() -> torch.Tensor:
        return Composite.apply(*splats, background, radii, None, composite)[0]

    outputs, v_outputs = project()[:4], [torch.ones_like(splat) for splat in splats[:4]]
    image = blend()
    jobs = {
        "project": project,
        "project backward": lambda: torch.autograd.grad(outputs, work.leaves[:4], v_outputs, retain_graph=True),
        "shade": lambda: shade(radii),
        "shade backward": lambda: torch.autograd.grad(colors, (means, sh_coeffs), splats[4], retain_graph=True),
        "bin and blend": blend,
        "blend backward": lambda: torch.autograd.grad(image, splats, work.v_image, retain_graph=True),
    }
    if device == "cpu":
        flat = Splats(*(vectors(t) if t.dim() == 3 else scalars(t) for t in splats))
        frame = Frame(1, load.width, load.height, vectors(background))
        jobs["bin"] = lambda: list_tiles(flat, vectors(radii), frame, threads=get_num_threads())
    metrics = []
    for job, function in jobs.items():
        metrics += time_metrics(f"{key}/{job}", median_time(function, repeats=repeats, warmup=1, device=device))
    wp.synchronize()
    return metrics
