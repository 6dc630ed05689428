"""Losses on images: photometric (L1 and SSIM) and multi-view consistency."""

from graphgs.losses.consistency import Reprojection, consistency_loss, reproject
from graphgs.losses.photometric import photometric_loss, ssim

__all__ = ["Reprojection", "consistency_loss", "photometric_loss", "reproject", "ssim"]
