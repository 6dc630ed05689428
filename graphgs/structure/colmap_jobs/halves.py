"""A database's verified matches divided by tracks."""

import shutil
from pathlib import Path

import numpy as np
import pycolmap
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from graphgs.structure.colmap_jobs.convert import Progress


def halve(
    database: str,
    halves: list[str],  # two new databases
    seed: int,
    progress: Progress,
) -> dict:
    """Two copies, each with the verified matches of one half of the tracks: whatever hangs together by matches goes to
    one side whole. Keypoints keep their numbers."""
    with pycolmap.Database.open(database) as db:
        pair_ids, geometries = db.read_two_view_geometries()
        counts = {image.image_id: db.num_keypoints_for_image(image.image_id) for image in db.read_all_images()}
    first = dict(zip(counts, np.cumsum([0, *counts.values()])[:-1], strict=True))
    pairs = [pycolmap.pair_id_to_image_pair(pair_id) for pair_id in pair_ids]
    ends = [
        np.asarray(geometry.inlier_matches, np.int64).reshape(-1, 2) + [first[i], first[j]]
        for (i, j), geometry in zip(pairs, geometries, strict=True)
    ]
    links = np.concatenate(ends) if ends else np.zeros((0, 2), np.int64)
    total = sum(counts.values())
    _, track = connected_components(coo_matrix((np.ones(len(links)), links.T), (total, total)), directed=False)
    side = np.random.default_rng(seed).integers(0, 2, int(track.max(initial=-1)) + 1)[track]
    for k, half in enumerate(halves):
        partial = Path(half + ".partial")
        shutil.copyfile(database, partial)
        with pycolmap.Database.open(partial) as db, pycolmap.DatabaseTransaction(db):
            for (i, j), geometry, link in zip(pairs, geometries, ends, strict=True):
                own = side[link[:, 0]] == k
                geometry.inlier_matches = (link[own] - [first[i], first[j]]).astype(np.uint32)
                db.delete_two_view_geometry(i, j)
                db.write_two_view_geometry(i, j, geometry)
        partial.rename(half)
        progress(k + 1, len(halves))
    return {"tracks": len(np.unique(track[links[:, 0]]))}
