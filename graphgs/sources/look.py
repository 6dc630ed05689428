"""A look at poses that came with photos, before all of these are decoded: what `graphgs check` needs to judge them."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from graphgs.scene.origin import near_zero
from graphgs.sources.config import SourcesConfig
from graphgs.sources.decode import UnusableError, decoding, read_header
from graphgs.sources.given import fit_to_photos
from graphgs.sources.layout import find_layout
from graphgs.sources.load import PixelBudget, decode_photo, describe_photo, make_folder
from graphgs.sources.photos import Photo, Photos
from graphgs.sources.poses import axes_in_use, given_poses


def look_at_given(
    config: SourcesConfig,
    source: Path,
    folder: Path,
    choose: Callable[[tuple[str, ...], np.ndarray], np.ndarray],  # (names, centres) of the posed photos -> which
    *,
    threads: int,
) -> Photos | None:
    """The photos with the poses that came with them, as `load_photos` has them, but of all photos only the headers are
    read; those that `choose` picks are decoded into `folder`. None without poses. Raises DataError as `load_photos`."""
    layout = find_layout(source, rigs=config.rigs == "auto")
    make_folder(folder / "photos")
    make_folder(folder / "masks")
    with decoding():
        poses = given_poses(layout, config)
        if poses is None:
            return None
        photos: dict[int, Photo] = {}
        for index, name in enumerate(layout.names):
            try:
                photos[index] = describe_photo(config, name, index, read_header(layout.root / name))
            except UnusableError:
                continue  # named by the scan
        given, origin = near_zero(fit_to_photos(poses, tuple(photos.values())))
        wanted = {given.names[k] for k in choose(given.names, given.centers)}
        budget = PixelBudget()

        def decoded(index: int) -> Photo | None:
            try:
                return decode_photo(config, layout, folder, budget, index)
            except UnusableError:
                return None

        chosen = [index for index, photo in photos.items() if photo.name in wanted]
        with ThreadPoolExecutor(threads) as pool:
            for index, photo in zip(chosen, pool.map(decoded, chosen), strict=True):
                photos[index] = photo
    lost = {layout.names[index] for index in chosen if photos[index] is None}
    kept = [k for k, name in enumerate(given.names) if name not in lost]
    return Photos(
        folder,
        tuple(photo for photo in photos.values() if photo is not None),
        given=given.of_images(np.array(kept, dtype=np.int64)),
        given_note=layout.note,
        origin=origin,
        given_axes=axes_in_use(config, layout),
    )
