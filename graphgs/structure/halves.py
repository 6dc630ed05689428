"""Models from disjoint halves of the tracks: two opinions that share the photos and nothing else."""

from pathlib import Path

from graphgs.scene.reconstruction import Reconstruction
from graphgs.structure.model_calls import ModelCalls


def models_of_halves(calls: ModelCalls, name: str) -> tuple[Reconstruction, Reconstruction] | None:
    """Two incremental models, each from the matches of one half of the tracks; None unless both come about.

    Mapped with another half of the matches, COLMAP starts from another pair and goes on in another order. With another
    seed alone it repeated the same model to 1e-6 degrees."""
    databases = [calls.scratch / f"{name}_{k}.db" for k in range(2)]
    if not all(database.exists() for database in databases):
        _halve(calls, databases)
    models = [calls.incremental(f"{name}_{k}", database=database) for k, database in enumerate(databases)]
    return None if any(model is None for model in models) else (models[0], models[1])


def _halve(calls: ModelCalls, databases: list[Path]) -> None:
    calls.worker.run("halve", database=calls.matches.database, halves=[str(d) for d in databases], seed=calls.seed)
