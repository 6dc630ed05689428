"""Checkpoints: tensors as safetensors, the rest as JSON, whole or absent, never pickled."""

import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from graphgs.errors import DiskError


@dataclass(frozen=True)
class Checkpoint:
    """The state after `step` executed steps."""

    step: int
    tensors: dict[str, Tensor]
    extra: dict  # plain JSON values
    fingerprint: str  # of everything that must agree between the run that wrote it and the one that goes on


def save_checkpoint(checkpoint: Checkpoint, folder: Path, name: str) -> None:
    """Write `name`, then drop its predecessor. The JSON is renamed last and names its tensor file, so at any moment
    the pair it describes is whole."""
    tensors = f"{name}_{checkpoint.step:07d}.safetensors"
    header = {
        "step": checkpoint.step,
        "fingerprint": checkpoint.fingerprint,
        "tensors": tensors,
        "extra": checkpoint.extra,
    }
    # the tensors as they are now, whatever training does next
    plain = {key: value.detach().cpu().contiguous() for key, value in checkpoint.tensors.items()}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _replace(folder / tensors, lambda partial: save_file(plain, partial))
        _replace(folder / f"{name}.json", lambda partial: partial.write_text(json.dumps(header)))
        for old in folder.glob(f"{name}_*.safetensors"):
            if old.name != tensors:
                old.unlink(missing_ok=True)
    except (OSError, SafetensorError) as error:
        raise DiskError(
            f"{folder}: a checkpoint could not be written ({error})",
            hint="free some space and run the same command again; training goes on from the last checkpoint",
        ) from error


def load_checkpoint(folder: Path, name: str, fingerprint: str) -> Checkpoint | None:
    """The checkpoint `name`, or None when there is none, it belongs to another run, or it is damaged."""
    try:
        header = json.loads((folder / f"{name}.json").read_text())
        if header["fingerprint"] != fingerprint:
            return None
        tensors = load_file(folder / Path(header["tensors"]).name)
        return Checkpoint(int(header["step"]), tensors, dict(header["extra"]), fingerprint)
    except (OSError, ValueError, KeyError, TypeError, SafetensorError):
        return None


def _replace(path: Path, write: Callable[[Path], object]) -> None:
    """Write beside, flush to the disk, rename."""
    partial = path.with_name(path.name + ".partial")
    try:
        write(partial)
        with open(partial, "rb+") as file:
            os.fsync(file.fileno())
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)
