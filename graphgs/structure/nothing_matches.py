"""Why photos cannot be matched at all, where it is the photos' own fault: blur or too little texture throughout."""

import numpy as np

from graphgs.errors import DataError
from graphgs.sources.photos import Photos
from graphgs.structure.edge_width import blur_words
from graphgs.structure.left_out import FEWEST_FEATURES
from graphgs.structure.sharpness import sharpness

_LOOKED_AT = 24  # photos, evenly spread
_MOST = 0.5  # share of them that must have the fault: then most pairs have it on one side at least


def fault_of_photos(
    photos: Photos,
    features: np.ndarray,  # [N] per photo
    *,
    threads: int,
) -> DataError | None:
    """What is wrong with most of the photos; None where they are sharp and show something."""
    n = len(photos.photos)
    sharp = sharpness(photos, np.unique(np.linspace(0, n - 1, min(n, _LOOKED_AT)).round().astype(int)), threads=threads)
    known = np.isfinite(sharp.edge_px)
    if known.any() and sharp.blurred[known].mean() > _MOST:
        return DataError(
            f"no three of the {n} photos could be matched, for they are {blur_words(np.median(sharp.edge_px[known]))}",
            hint="take them again, in focus and with a short exposure, or leave the blurred ones out",
        )
    if (features < FEWEST_FEATURES).mean() > _MOST:
        return DataError(
            f"no three of the {n} photos could be matched, for they show too little texture: {np.median(features):.0f} "
            f"features in a typical one, where {FEWEST_FEATURES} are needed",
            hint="bare walls, water and sky have nothing to match: take photos with something in them",
        )
    return None
