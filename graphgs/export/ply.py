"""splat.ply: the 62-float layout that every 3D Gaussian viewer reads, and a comment `near` that ours does, too. A
comment `origin` says for people and programs where the scene's zero lies in the frame its poses came in."""

import math
import os
from pathlib import Path

import numpy as np
import torch

from graphgs.errors import DataError, DiskError
from graphgs.rendering.splats import NEAR, Splats
from graphgs.scene.origin import AT_ZERO, Origin

PROPERTIES = (
    *("x", "y", "z", "nx", "ny", "nz"),
    *(f"f_dc_{c}" for c in range(3)),
    *(f"f_rest_{k}" for k in range(45)),  # channel-major: 15 red, 15 green, 15 blue
    "opacity",  # before the sigmoid
    *(f"scale_{a}" for a in range(3)),  # log
    *(f"rot_{a}" for a in range(4)),  # wxyz
)
MAX_HEADER_BYTES = 64 * 1024


def write_ply(splats: Splats, path: Path, *, origin: Origin = AT_ZERO) -> None:
    """Write binary little-endian, whole or not at all. Harmonics above `splats.sh_degree` are written as zero.
    Positions are written as they are, relative to `origin`."""
    sh_coeffs = splats.sh_coeffs.detach().cpu().clone()
    sh_coeffs[:, (splats.sh_degree + 1) ** 2 :] = 0.0
    columns = [
        splats.means,
        torch.zeros(len(splats), 3),  # normals: unused, expected by readers
        sh_coeffs[:, 0],
        sh_coeffs[:, 1:].transpose(1, 2).reshape(len(splats), 45),
        splats.logit_opacities[:, None],
        splats.log_scales,
        splats.quats,
    ]
    rows = torch.cat([column.detach().cpu().float() for column in columns], dim=1).numpy().astype("<f4")
    if not np.isfinite(rows).all():
        raise DataError(f"{path.name}: the scene holds values that are not finite, so it was not written")
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment near {splats.near!r}",
        *([] if origin == AT_ZERO else ["comment origin {!r} {!r} {!r}".format(*origin)]),
        f"element vertex {len(splats)}",
    ]
    header += [f"property float {name}" for name in PROPERTIES] + ["end_header", ""]
    partial = path.with_name(path.name + ".partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(partial, "wb") as file:
            file.write("\n".join(header).encode("ascii"))
            file.write(rows.tobytes())
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise DiskError(
            f"{path}: {error.strerror or error}", hint="free some space, or choose another folder"
        ) from error


def read_ply(path: Path) -> Splats:
    """Read what `write_ply` or another trainer wrote: float properties in any order, harmonics of degree 0 to 3.
    Raises DataError on anything else; sizes are checked before memory is taken."""
    try:
        size = path.stat().st_size
        with open(path, "rb") as file:
            head = file.read(min(size, MAX_HEADER_BYTES))
            count, names, near, begin = _parse_header(head, path)
            if size != begin + 4 * len(names) * count:
                raise DataError(
                    f"{path}: the header promises {count} Gaussians of {len(names)} floats, the file holds "
                    f"{size - begin} bytes instead of {4 * len(names) * count}",
                    hint="the file was cut short; export it again",
                )
            file.seek(begin)
            rows = np.fromfile(file, dtype="<f4", count=count * len(names)).reshape(count, len(names))
    except OSError as error:
        raise DataError(f"{path}: {error.strerror or error}") from error
    if not np.isfinite(rows).all():
        raise DataError(f"{path}: holds values that are not finite")
    return _to_splats(rows, {name: k for k, name in enumerate(names)}, near, path)


def _parse_header(head: bytes, path: Path) -> tuple[int, list[str], float, int]:
    """(number of Gaussians, property names, near plane, offset of the first row)."""
    end = head.find(b"end_header\n")
    if not head.startswith(b"ply\n") or end < 0:
        raise DataError(f"{path}: not a ply file with a readable header")
    lines = head[:end].decode("ascii", errors="replace").splitlines()[1:]
    count, names, near = None, [], NEAR
    for words in (line.split() for line in lines):
        match words:
            case ["format", kind, "1.0"]:
                if kind != "binary_little_endian":
                    raise DataError(f"{path}: format {kind}, expected binary_little_endian")
            case ["element", "vertex", number] if number.isdigit() and count is None:
                count = int(number)
            case ["property", "float" | "float32", name] if count is not None:
                names.append(name)
            case ["comment", "near", number] if _is_positive(number):
                near = float(number)
            case ["comment" | "obj_info", *_] | []:
                pass
            case _:
                raise DataError(f"{path}: unexpected header line {' '.join(words)[:80]!r}")
    if count is None:
        raise DataError(f"{path}: no vertex element")
    return count, names, near, end + len(b"end_header\n")


def _is_positive(number: str) -> bool:
    try:
        return 0.0 < float(number) < math.inf
    except ValueError:
        return False


def _to_splats(rows: np.ndarray, column: dict[str, int], near: float, path: Path) -> Splats:
    rest = sum(name.startswith("f_rest_") for name in column)
    degrees = {0: 0, 9: 1, 24: 2, 45: 3}
    needed = [name for name in PROPERTIES if not name.startswith(("n", "f_rest_"))]
    needed += [f"f_rest_{k}" for k in range(rest)]
    missing = [name for name in needed if name not in column]
    if missing or rest not in degrees:
        raise DataError(
            f"{path}: not a Gaussian scene: "
            + (f"no property {missing[0]}" if missing else f"{rest} f_rest properties")
        )

    def take(*names: str) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(rows[:, [column[name] for name in names]]))

    sh_coeffs = torch.zeros(len(rows), 16, 3)
    sh_coeffs[:, 0] = take("f_dc_0", "f_dc_1", "f_dc_2")
    if rest:
        per_channel = take(*(f"f_rest_{k}" for k in range(rest))).reshape(len(rows), 3, rest // 3)
        sh_coeffs[:, 1 : 1 + rest // 3] = per_channel.transpose(1, 2)
    return Splats(
        means=take("x", "y", "z"),
        quats=take("rot_0", "rot_1", "rot_2", "rot_3"),
        log_scales=take("scale_0", "scale_1", "scale_2"),
        logit_opacities=take("opacity")[:, 0].clone(),
        sh_coeffs=sh_coeffs,
        sh_degree=degrees[rest],
        near=near,
    )
