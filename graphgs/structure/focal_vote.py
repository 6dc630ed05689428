"""The focal length that the verified pairs of a database vote for."""

import dataclasses
from pathlib import Path

import numpy as np

from graphgs.structure.cameras import SharedCameras
from graphgs.structure.colmap import ColmapWorker
from graphgs.structure.focal import FocalVote, vote_focal


def vote_of_pairs(
    worker: ColmapWorker,
    database: Path,
    work: Path,  # gets fundamentals.npz
    cameras: SharedCameras,
) -> FocalVote:
    """Among the photos that do not tell their focal length, if they have pairs enough; else among all."""
    worker.run("fundamentals", database=database, out=work / "fundamentals.npz")
    with np.load(work / "fundamentals.npz", allow_pickle=False) as arrays:
        pairs, F, inliers = arrays["pairs"], arrays["F"], arrays["inliers"]
    Ks = np.array([camera.K for camera in cameras.cameras])
    camera = cameras.camera_ids[pairs]
    guessed = ~np.array(cameras.known)[camera].any(1)
    subsets = [guessed, np.ones(len(pairs), bool)] if guessed.any() else [np.ones(len(pairs), bool)]
    for subset in subsets:
        i, j = camera[subset].T
        vote = vote_focal(F[subset], inliers[subset], Ks[i], Ks[j])
        if vote.decided:
            # Only what guessed cameras say may move the guesses.
            return vote if subset is guessed else dataclasses.replace(vote, scale=1.0)
    return vote
