"""Facts about one photo, as plain data."""

import difflib
from collections import Counter
from typing import Any

import numpy as np

from graphgs.errors import UsageError
from graphgs.explain.artefacts import Artefacts
from graphgs.structure.pair_set import KIND_NAMES

_CLOSE_NAMES = 5


def find_photo(found: Artefacts, wanted: str) -> str:
    """The photo of that name, or the only one whose name ends so. Raises UsageError that tells the close ones."""
    names = [*found.photos.names, *(skipped.name for skipped in found.photos.skipped)]
    if wanted in names:
        return wanted
    ending = [name for name in names if name.endswith(wanted)] or [name for name in names if _stem(name) == wanted]
    if len(ending) == 1:
        return ending[0]
    if ending:
        listed = ", ".join(ending[:_CLOSE_NAMES]) + (", ..." if len(ending) > _CLOSE_NAMES else "")
        raise UsageError(f"{wanted}: {len(ending)} photos end so: {listed}", hint="give more of the name")
    close = difflib.get_close_matches(wanted, names, n=_CLOSE_NAMES, cutoff=0.5)
    hint = f"did you mean {', '.join(close)}?" if close else f"names look like {names[0]}"
    raise UsageError(f"{wanted}: no photo of that name in this scene", hint=hint)


def photo_facts(found: Artefacts, name: str) -> dict[str, Any]:
    """Its pose, role and importance, and every pair tried with it. Plain values, for people and programs."""
    for skipped in found.photos.skipped:
        if skipped.name == name:
            return {"name": name, "placed": False, "role": None, "cause": "unusable", "reason": skipped.reason}
    k, structure, diagnosis = found.row[name], found.structure, found.diagnosis
    placed = name in found.node
    facts: dict[str, Any] = {
        "name": name,
        "placed": placed,
        "role": "test" if found.photos.is_test[k] else "training",
        "psnr": None if found.scores is None else found.scores.get(name),
        "cause": None,
        "reason": dict(structure.unregistered).get(name),
    }
    if diagnosis is not None:
        facts |= {
            "cause": next((entry.cause for entry in diagnosis.left_out if entry.name == name), None),
            "features": int(diagnosis.features[k]),
            "points": int(diagnosis.points[k]),
            "error_px": _finite(diagnosis.error_px[k]),
            "sharpness": _finite(diagnosis.sharpness[k]),
            "group": _group(found, name),
        }
    if placed:
        facts |= _pose(found, name)
    return facts | {"pairs": tried_pairs(found, name)}


def tried_pairs(found: Artefacts, name: str) -> list[dict[str, Any]]:
    """Every pair matched with a photo, those with most verified matches first. Without matches of our own (poses came
    with points): the pairs that see points together."""
    diagnosis, why = found.diagnosis, _why(found, name)
    if diagnosis is None:
        return _sharing_points(found, name)
    k, tried = found.row[name], diagnosis.tried
    support = _support(found, name)
    pairs = []
    for row in np.flatnonzero((tried.pairs == k).any(1)):
        other = found.photos.names[int(tried.pairs[row].sum() - k)]
        supported, contradicted = support.get(other, (None, None))
        pairs.append(
            {
                "name": other,
                "why": why.get(other, ["came later: look-alikes, to join groups and to test the poses"]),
                "matches": int(tried.matches[row]),
                "inliers": int(tried.inliers[row]),
                "supported": supported,
                "contradicted": contradicted,
            }
        )
    return sorted(pairs, key=lambda pair: (-pair["inliers"], -pair["matches"], pair["name"]))


def _pose(found: Artefacts, name: str) -> dict[str, Any]:
    model, node = found.structure.reconstruction, found.node[name]
    rotation = model.rotations[node]
    camera = model.camera_of(node)
    facts: dict[str, Any] = {
        "center": model.centers[node].tolist(),
        "direction": rotation[2].tolist(),  # the optical axis in the world
        "rotation": rotation.tolist(),  # camera-from-world
        "metric": found.structure.world is not None,
        "focal_px": camera.focal_and_center[0],
        "camera_model": camera.model,
    }
    if found.graph is not None and name in found.graph.names:
        index, importance = found.graph.names.index(name), found.graph.importance()
        target = int(found.graph.targets()[index])
        facts |= {
            "importance": float(importance[index]),
            "importance_rank": int((importance > importance[index]).sum()) + 1,
            "target": found.graph.names[target] if target >= 0 else None,
        }
    return facts


def _group(found: Artefacts, name: str) -> str | None:
    """Where the photos fall into several."""
    groups = found.structure.grouping.groups
    return next((group.name for group in groups if name in group.photos), None) if len(groups) > 1 else None


def _why(found: Artefacts, name: str) -> dict[str, list[str]]:
    """Why each partner was a candidate."""
    if found.pairs is None or name not in found.pairs.names:
        return {}
    k = found.pairs.names.index(name)
    rows = np.flatnonzero((found.pairs.pairs == k).any(1))
    return {
        found.pairs.names[int(found.pairs.pairs[row].sum() - k)]: [
            word for bit, word in KIND_NAMES.items() if found.pairs.kinds[row] & bit
        ]
        or ["all pairs"]
        for row in rows
    }


def _support(found: Artefacts, name: str) -> dict[str, tuple[int, int]]:
    """(supported, contradicted) matches with each placed partner."""
    if name not in found.node:
        return {}
    node, support = found.node[name], found.diagnosis.support
    names = found.structure.reconstruction.names
    return {
        names[int(support.pairs[row].sum() - node)]: (int(support.supported[row]), int(support.contradicted[row]))
        for row in np.flatnonzero((support.pairs == node).any(1))
    }


def _sharing_points(found: Artefacts, name: str) -> list[dict[str, Any]]:
    if name not in found.node:
        return []
    node, structure = found.node[name], found.structure
    names = structure.reconstruction.names
    shared = Counter(
        {
            names[int(structure.edges[row].sum() - node)]: int(structure.inliers[row])
            for row in np.flatnonzero((structure.edges == node).any(1))
        }
    )
    return [
        {"name": other, "why": ["sees the same points"], "matches": count, "inliers": count, "supported": count,
         "contradicted": 0}
        for other, count in shared.most_common()
    ]  # fmt: skip


def _stem(name: str) -> str:
    return name.rsplit("/", 1)[-1].rsplit(".", 1)[0]


def _finite(value: float) -> float | None:
    return round(float(value), 3) if np.isfinite(value) else None
