"""Verified matches read from COLMAP's file, as its own library writes them."""

import sqlite3

import numpy as np

from graphgs.structure.evidence import read_tried, read_verified

BASE = 2**31 - 1


def database(path):
    """Three photos; 1-2 verified, 1-3 matched and not verified, 2-3 verified."""
    keypoints = {k: np.arange(12, dtype=np.float32).reshape(2, 6) + 100 * k for k in (1, 2, 3)}
    keypoints[1] = np.array([[5, 6], [7, 8], [9, 10]], np.float32)  # two columns are allowed as well
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE keypoints (image_id, rows, cols, data)")
        connection.execute("CREATE TABLE matches (pair_id, rows, cols, data)")
        connection.execute("CREATE TABLE two_view_geometries (pair_id, rows, cols, data, config)")
        for image_id, found in keypoints.items():
            connection.execute("INSERT INTO keypoints VALUES (?, ?, ?, ?)", (image_id, *found.shape, found.tobytes()))
        connection.execute("INSERT INTO keypoints VALUES (4, 0, 6, NULL)")  # a photo without features
        for pair, rows in (((2, 3), 9), ((1, 2), 8), ((1, 3), 7)):
            connection.execute("INSERT INTO matches VALUES (?, ?, 2, NULL)", (BASE * pair[0] + pair[1], rows))
        for pair, found in (((2, 3), [[0, 1]]), ((1, 2), [[2, 0], [0, 1]]), ((1, 3), [])):
            data = np.array(found, np.uint32).reshape(-1, 2)
            row = (BASE * pair[0] + pair[1], len(data), data.tobytes() or None)
            connection.execute("INSERT INTO two_view_geometries VALUES (?, ?, 2, ?, 2)", row)
    connection.close()


def test_matches_come_as_positions_pair_after_pair(tmp_path):
    database(tmp_path / "a database.db")
    found = read_verified(tmp_path / "a database.db")
    assert found.pairs.tolist() == [[0, 1], [1, 2]]
    assert found.offsets.tolist() == [0, 2, 3]
    assert found.pair_of.tolist() == [0, 0, 1]
    assert found.xy_i.tolist() == [[9, 10], [5, 6], [200, 201]]
    assert found.xy_j.tolist() == [[200, 201], [206, 207], [306, 307]]


def test_every_pair_tried_is_counted(tmp_path):
    database(tmp_path / "database.db")
    tried = read_tried(tmp_path / "database.db")
    assert tried.pairs.tolist() == [[0, 1], [0, 2], [1, 2]]
    assert tried.matches.tolist() == [8, 7, 9]
    assert tried.inliers.tolist() == [2, 0, 1]
