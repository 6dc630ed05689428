"""What GraphGS asks of COLMAP. Nothing else imports pycolmap; all of it runs in a child process (`colmap_worker`).

Each job takes plain values and leaves its result in files, so that a killed job costs only itself: features and matches
go to the database image by image and pair by pair, a model appears by one rename.
"""

import sqlite3  # noqa: F401  (these first: pycolmap bundles libraries of the same names)
import zlib  # noqa: F401

import cv2  # noqa: F401
import numpy  # noqa: F401
import pycolmap

from graphgs.structure.colmap_jobs.database import (
    create_database,
    fundamentals,
    match,
    restrict,
    set_cameras,
    settle,
    unmatched,
    verified,
)
from graphgs.structure.colmap_jobs.features import extract
from graphgs.structure.colmap_jobs.given_matches import verify_given
from graphgs.structure.colmap_jobs.halves import halve
from graphgs.structure.colmap_jobs.mapping import map_globally, map_incrementally, triangulate
from graphgs.structure.colmap_jobs.rigs import adjust_rigs
from graphgs.structure.colmap_jobs.trial import adjust

__all__ = ["JOBS", "pycolmap"]

JOBS = {
    job.__name__: job
    for job in (
        extract,
        create_database,
        set_cameras,
        match,
        unmatched,
        restrict,
        verify_given,
        verified,
        fundamentals,
        settle,
        map_incrementally,
        map_globally,
        triangulate,
        adjust_rigs,
        adjust,
        halve,
    )
}
