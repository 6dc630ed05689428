"""graph.json: the camera graph in networkx's node-link form, for people and other programs."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from graphgs.errors import DataError
from graphgs.structure.pair_set import KIND_NAMES

if TYPE_CHECKING:
    from graphgs.graph.camera_graph import CameraGraph


def write_graph(graph: "CameraGraph", path: Path) -> None:
    importance, probability, target = graph.importance(), graph.sampling_probability(), graph.targets()
    weights = graph.edge_weights()
    nodes = [
        {
            "id": i,
            "image": name,
            "rotation": graph.rotations[i].tolist(),  # camera-from-world
            "center": graph.centers[i].tolist(),  # world
            "importance": float(importance[i]),
            "sampling_probability": float(probability[i]),
            "target": int(target[i]),  # -1 = none
            "is_test": bool(graph.is_test[i]),
        }
        for i, name in enumerate(graph.names)
    ]
    edges = [
        {"source": int(i), "target": int(j), "weight": float(weights[e]), "inliers": int(graph.inliers[e])}
        for e, (i, j) in enumerate(graph.edges)
    ]
    if graph.kinds is not None:
        for edge, kind in zip(edges, graph.kinds.tolist(), strict=True):
            edge["why"] = [name for bit, name in KIND_NAMES.items() if kind & bit]
    data = {"directed": False, "multigraph": False, "graph": {"format": 1}, "nodes": nodes, "edges": edges}
    path = _file_of(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(data, allow_nan=False), encoding="utf-8")


def read_graph(path: Path) -> "CameraGraph":
    from graphgs.graph.camera_graph import CameraGraph

    path = _file_of(path)
    hint = "Delete it and run again: it is made from the structure stage's result."
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        nodes, edges = data["nodes"], data["edges"]
        if [node["id"] for node in nodes] != list(range(len(nodes))):
            raise ValueError("node ids are not 0, 1, 2, ...")
        bit_of = {name: bit for bit, name in KIND_NAMES.items()}
        why = [edge.get("why") for edge in edges]
        kinds = None if None in why else np.array([sum(bit_of[name] for name in set(w)) for w in why], np.uint8)
        return CameraGraph(
            names=tuple(node["image"] for node in nodes),
            rotations=np.array([node["rotation"] for node in nodes], np.float64),
            centers=np.array([node["center"] for node in nodes], np.float64),
            edges=np.array([(edge["source"], edge["target"]) for edge in edges], np.int64),
            inliers=np.array([edge["inliers"] for edge in edges], np.int64),
            is_test=np.array([node["is_test"] for node in nodes], bool),
            kinds=kinds,
        )
    except (ValueError, KeyError, TypeError) as error:
        raise DataError(f"{path}: not a camera graph ({error})", hint=hint) from error


def _file_of(path: Path) -> Path:
    return path if path.suffix == ".json" else path / "graph.json"
