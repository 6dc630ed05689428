"""Facts about a whole scene, as plain data."""

import dataclasses
from typing import Any

import numpy as np

from graphgs.explain.artefacts import Artefacts
from graphgs.structure.shortfall import partial_error

_SHOWN = 8  # weakest cameras


def scene_facts(found: Artefacts) -> dict[str, Any]:
    """Groups, photos left out, how sure the poses are, the weakest cameras. Plain values, for people and programs."""
    structure, diagnosis = found.structure, found.diagnosis
    agreed = structure.agreement
    partial = partial_error(structure, len(found.photos.names), found.limits)
    return {
        "photos": len(found.photos.names),
        "placed": len(structure.reconstruction.names),
        "accepted": structure.accepted,
        "method": structure.method,
        "doubts": list(structure.doubts),
        "cautions": list(structure.cautions),
        "origin": list(structure.origin),
        "lenses": None if structure.calibration is None else structure.calibration.describe(),
        "agreement": None if agreed is None else dataclasses.asdict(agreed) | {"with": structure.compared_with},
        "contradicted_share": None if diagnosis is None else diagnosis.soundness.contradicted_share,
        "partial": None if partial is None else partial.message,
        "groups": [_group(group) for group in structure.grouping.groups],
        "left_out": _left_out(found),
        "skipped": [dataclasses.asdict(skipped) for skipped in found.photos.skipped],
        "weakest": weakest_cameras(found),
        "cut_pairs": cut_pairs(found),
    }


def weakest_cameras(found: Artefacts) -> list[dict[str, Any]]:
    """The cameras that hang on least, beside the medians of all, the weakest first. `weakness` is the worst of three
    ratios: the median number of points to its own, that of verified matches, its reprojection error to the median."""
    diagnosis, model = found.diagnosis, found.structure.reconstruction
    if diagnosis is None or not model.names:
        return []
    rows = np.array([found.row[name] for name in model.names])
    points, error = diagnosis.points[rows], diagnosis.error_px[rows]
    inliers, pairs = np.zeros(len(rows), np.int64), np.zeros(len(rows), np.int64)
    for side in range(2):
        np.add.at(inliers, diagnosis.support.pairs[:, side], diagnosis.support.supported)
        np.add.at(pairs, diagnosis.support.pairs[:, side], diagnosis.support.supported > 0)
    ratios = np.stack(
        [_times(np.median(points), points), _times(np.median(inliers), inliers), _times(error, np.median(error))]
    )
    weakness = ratios.max(0)
    words = ("few points", "few matches", "large error")
    return [
        {
            "name": model.names[k],
            "weakness": round(float(weakness[k]), 2),
            "because": words[int(ratios[:, k].argmax())],
            "points": int(points[k]),
            "matches": int(inliers[k]),
            "pairs": int(pairs[k]),
            "error_px": round(float(error[k]), 3),
        }
        for k in np.argsort(-weakness, kind="stable")[:_SHOWN]
    ]


def cut_pairs(found: Artefacts) -> list[list[str]]:
    """Pairs without which the camera graph would fall apart, as names: only they hold its two sides together."""
    if found.graph is None or not len(found.graph.edges):
        return []
    import rustworkx

    graph = rustworkx.PyGraph()
    graph.add_nodes_from(range(len(found.graph.names)))
    graph.add_edges_from_no_data([(int(i), int(j)) for i, j in found.graph.edges])
    cuts = sorted(tuple(sorted(edge)) for edge in rustworkx.bridges(graph))
    return [[found.graph.names[i], found.graph.names[j]] for i, j in cuts]


def _times(more: np.ndarray, less: np.ndarray) -> np.ndarray:
    return np.asarray(more, float) / np.maximum(np.asarray(less, float), 1e-9)


def _group(group) -> dict[str, Any]:
    plain = {"name": group.name, "photos": list(group.photos), "bridge": None}
    if group.bridge is not None:
        plain["bridge"] = dataclasses.asdict(group.bridge) | {"advice": group.bridge.advice()}
    return plain


def _left_out(found: Artefacts) -> list[dict[str, Any]]:
    causes = {} if found.diagnosis is None else {entry.name: entry.cause for entry in found.diagnosis.left_out}
    return [
        {"name": name, "cause": causes.get(name), "reason": reason} for name, reason in found.structure.unregistered
    ]
