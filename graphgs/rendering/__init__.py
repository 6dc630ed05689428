"""Rendering: Gaussians and cameras in, images, depths and gradients out."""

from graphgs.rendering.rasterize import RenderOutput, rasterize

__all__ = ["RenderOutput", "rasterize"]
