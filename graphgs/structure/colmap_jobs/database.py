"""COLMAP's database: images and features in, matches and their verification, verified pairs out."""

import sqlite3
from pathlib import Path

import numpy as np
import pycolmap

from graphgs.structure.colmap_jobs.convert import Progress, to_camera


def create_database(
    database: str,
    images: list[str],  # [N] pixel files; image i gets the id i + 1
    camera_of_image: list[int],  # [N] into `cameras`
    cameras: list[dict],  # fields of graphgs.scene.Camera, and `known`: the focal length is more than a guess
    features: str,  # folder that `extract` filled
    progress: Progress,
) -> dict:
    """A database of images, shared cameras and features. It appears by one rename."""
    path, partial = Path(database), Path(database + ".partial")
    for leftover in path.parent.glob(partial.name + "*"):
        leftover.unlink()
    with pycolmap.Database.open(partial) as db:
        for camera_id, fields in enumerate(cameras, 1):
            db.write_camera(to_camera(camera_id, fields), use_camera_id=True)
            rig = pycolmap.Rig(rig_id=camera_id)
            rig.add_ref_sensor(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera_id))
            db.write_rig(rig, use_rig_id=True)
        for image_id, (name, camera) in enumerate(zip(images, camera_of_image, strict=True), 1):
            image = pycolmap.Image(name=name, camera_id=camera + 1, image_id=image_id)
            db.write_image(image, use_image_id=True)
            frame = pycolmap.Frame(frame_id=image_id, rig_id=camera + 1)
            frame.add_data_id(image.data_id)
            db.write_frame(frame, use_frame_id=True)
            with np.load(Path(features) / f"{name}.npz", allow_pickle=False) as arrays:
                db.write_keypoints(image_id, arrays["keypoints"])
                described = pycolmap.FeatureDescriptors(pycolmap.FeatureExtractorType.SIFT, arrays["descriptors"])
                db.write_descriptors(image_id, described)
    _settle(partial)
    partial.rename(path)
    return {}


def set_cameras(database: str, cameras: list[dict], progress: Progress) -> dict:
    """Replace the intrinsics of every camera."""
    with pycolmap.Database.open(database) as db:
        for camera_id, fields in enumerate(cameras, 1):
            db.update_camera(to_camera(camera_id, fields))
    return {}


def match(
    database: str,
    pairs: list[tuple[int, int]],  # image indices
    chunk_pairs: int,
    matching: dict,  # FeatureMatchingOptions
    verification: dict,  # TwoViewGeometryOptions
    threads: int,
    scratch: str,
    progress: Progress,
) -> dict:
    """Match and verify the given pairs, a chunk at a time; pairs in the database already are passed over."""
    matching_options = pycolmap.FeatureMatchingOptions(num_threads=threads, use_gpu=False)
    matching_options.mergedict(matching)
    verification_options = pycolmap.TwoViewGeometryOptions()
    verification_options.mergedict(verification)
    with pycolmap.Database.open(database) as db:
        names = [db.read_image(i + 1).name for i in range(db.num_images())]
        pending = _unmatched(db, pairs)
    listing = Path(scratch) / "pairs.txt"
    finished = len(pairs) - len(pending)
    progress(finished, len(pairs))
    for first in range(0, len(pending), chunk_pairs):
        chunk = pending[first : first + chunk_pairs]
        listing.write_text("".join(f"{names[i]} {names[j]}\n" for i, j in chunk))
        pycolmap.match_image_pairs(
            database,
            matching_options,
            pycolmap.ImportedPairingOptions(match_list_path=listing),
            verification_options,
            pycolmap.Device.cpu,
        )
        finished += len(chunk)
        progress(finished, len(pairs))
    return {"matched_now": len(pending)}


def unmatched(
    database: str,
    pairs: list[tuple[int, int]],  # image indices
    progress: Progress,
) -> dict:
    """Those of the pairs that `match` has still to do, in its order."""
    with pycolmap.Database.open(database) as db:
        return {"pairs": _unmatched(db, pairs)}


def _unmatched(db: pycolmap.Database, pairs: list[tuple[int, int]]) -> list[tuple[int, int]]:
    return [(i, j) for i, j in pairs if not db.exists_two_view_geometry(i + 1, j + 1)]


def restrict(
    database: str,
    pairs: list[tuple[int, int]],  # image indices i < j
    progress: Progress,
) -> dict:
    """Forget the matches of all other pairs."""
    wanted = {(i + 1, j + 1) for i, j in pairs}
    with pycolmap.Database.open(database) as db:
        found = {pycolmap.pair_id_to_image_pair(pair_id) for pair_id in db.read_num_matches()[0]}
        found |= {pycolmap.pair_id_to_image_pair(pair_id) for pair_id in db.read_two_view_geometry_num_inliers()[0]}
        with pycolmap.DatabaseTransaction(db):
            for pair in found - wanted:
                db.delete_matches(*pair)
                db.delete_two_view_geometry(*pair)
    _settle(Path(database))
    return {"kept": len(found & wanted)}


def verified(database: str, out: str, progress: Progress) -> dict:
    """The verified pairs in one npz: `edges` [E, 2] image indices i < j, sorted; `inliers` [E]."""
    with pycolmap.Database.open(database) as db:
        pair_ids, counts = db.read_two_view_geometry_num_inliers()
        pairs = [pycolmap.pair_id_to_image_pair(p) for p in pair_ids]
    edges = np.array(pairs, dtype=np.int64).reshape(-1, 2) - 1
    inliers = np.array(counts, dtype=np.int64)
    keep = inliers > 0
    edges, inliers = edges[keep], inliers[keep]
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    np.savez(out, edges=edges[order], inliers=inliers[order])
    return {}


def fundamentals(database: str, out: str, progress: Progress) -> dict:
    """The fundamental matrices of verified pairs in general position, in one npz: `pairs` [P, 2], `F` [P, 3, 3] with
    x_j^T F x_i = 0 in px, `inliers` [P]."""
    general = {
        int(pycolmap.TwoViewGeometryConfiguration.CALIBRATED),
        int(pycolmap.TwoViewGeometryConfiguration.UNCALIBRATED),
    }
    with pycolmap.Database.open(database) as db:
        pair_ids, geometries = db.read_two_view_geometries()
    chosen = [
        (pycolmap.pair_id_to_image_pair(pair_id), geometry)
        for pair_id, geometry in zip(pair_ids, geometries, strict=True)
        if geometry.config in general and geometry.F is not None
    ]
    np.savez(
        out,
        pairs=np.array([pair for pair, _ in chosen], dtype=np.int64).reshape(-1, 2) - 1,
        F=np.array([geometry.F for _, geometry in chosen]).reshape(-1, 3, 3),
        inliers=np.array([len(geometry.inlier_matches) for _, geometry in chosen], dtype=np.int64),
    )
    return {}


def settle(database: str, progress: Progress) -> dict:
    """Fold the write-ahead log into the database, so that the one file is the whole of it."""
    _settle(Path(database))
    return {}


def _settle(database: Path) -> None:
    connection = sqlite3.connect(database)
    connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    connection.execute("PRAGMA journal_mode=DELETE")
    connection.close()
