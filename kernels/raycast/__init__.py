"""Ray casting of textured triangle meshes: exact colour and depth images of a known scene."""

from graphgs.kernels.raycast.textured import TexturedScene, raycast

__all__ = ["TexturedScene", "raycast"]
