"""Fused SSIM and L1 of two images, forward and hand-written backward."""

from graphgs.kernels.ssim.compare import ImagePair, compare_images, compare_images_gradient

__all__ = ["ImagePair", "compare_images", "compare_images_gradient"]
