"""Colours of the points: the mean of the pixels where each was seen."""

import dataclasses
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np

from graphgs.scene.reconstruction import Reconstruction
from graphgs.sources.photos import Photos


def colored(reconstruction: Reconstruction, photos: Photos, *, threads: int) -> Reconstruction:
    """The reconstruction with point colours read from the decoded photos. The same for any number of threads."""
    file_of = {photo.name: photos.folder / photo.pixels for photo in photos.photos}
    of_image = [np.flatnonzero(reconstruction.track_images == k) for k in range(len(reconstruction.names))]
    seen = np.zeros((len(reconstruction.track_images), 3), np.uint8)

    def read(k: int) -> None:
        image = cv2.imread(str(file_of[reconstruction.names[k]]), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        if image is None:
            raise OSError(f"{file_of[reconstruction.names[k]]}: cannot read the decoded photo")
        x, y = np.floor(reconstruction.track_xy[of_image[k]]).astype(int).T
        columns, rows = np.clip(x, 0, image.shape[1] - 1), np.clip(y, 0, image.shape[0] - 1)
        seen[of_image[k]] = image[rows, columns, ::-1]

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(read, [k for k, rows in enumerate(of_image) if len(rows)]))
    if len(reconstruction.points) == 0:
        return reconstruction
    total = np.add.reduceat(seen.astype(np.int64), reconstruction.track_offsets[:-1], axis=0)
    mean = np.rint(total / reconstruction.track_lengths[:, None])
    return dataclasses.replace(reconstruction, colors=mean.astype(np.uint8))
