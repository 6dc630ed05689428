"""From Gaussians and cameras to images, differentiable."""

from graphgs.kernels.rasterize.gpu import IntersectionOverflow
from graphgs.rendering.rasterize import RenderOutput, rasterize

__all__ = ["IntersectionOverflow", "RenderOutput", "rasterize"]
