"""How good a scene is: image metrics on held-out views, and the report."""

from graphgs.evaluation.metrics import psnr, ssim

__all__ = ["psnr", "ssim"]
