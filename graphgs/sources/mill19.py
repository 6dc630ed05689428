"""Mill-19 and the other scenes of Mega-NeRF: {train,val}/rgbs/NAME.jpg with {train,val}/metadata/NAME.pt.

The metadata hold H, W [px], intrinsics (fx, fy, cx, cy) [px] and c2w [3, 4]: the camera's axes are OpenGL's (x right, y
up, z backwards), the world's point down, right and backwards and are scaled to [-1, 1]. The pictures are undistorted.
"""

from pathlib import Path

import numpy as np

from graphgs.errors import DataError
from graphgs.sources.pt_file import MAX_BYTES, read_pt
from graphgs.sources.transforms import OURS_FROM_OPENGL, Frame, Transforms

SPLITS = ("train", "val")
HINT = "expected is the layout of Mega-NeRF (github.com/cmusatyalab/mega-nerf, custom data)"


def is_mill19(folder: Path) -> bool:
    return (folder / "train" / "rgbs").is_dir() and (folder / "train" / "metadata").is_dir()


def photo_folders(folder: Path) -> tuple[str, ...]:
    return tuple(f"{split}/rgbs" for split in SPLITS if (folder / split / "rgbs").is_dir())


def read_mill19(folder: Path, names: tuple[str, ...]) -> Transforms:
    """The poses of the named photos ("train/rgbs/000001.jpg"); those without metadata have none. Raises DataError."""
    frames = []
    for name in names:
        path = (folder / name).parent.parent / "metadata" / f"{Path(name).stem}.pt"
        if not path.is_file():
            continue
        try:
            if path.stat().st_size > MAX_BYTES:
                raise ValueError("larger than 50 MB")
            frames.append(_frame(name, read_pt(path)))
        except (OSError, ValueError) as error:
            raise DataError(f"{path}: {error}", hint=HINT) from None
    return Transforms(folder / "train" / "metadata", tuple(frames), axes="opengl")


def _frame(name: str, data) -> Frame:
    if not isinstance(data, dict) or not {"H", "W", "c2w", "intrinsics"} <= data.keys():
        raise ValueError("no metadata: H, W, c2w and intrinsics are needed")
    matrix = np.asarray(data["c2w"], dtype=np.float64)
    lens = np.asarray(data["intrinsics"], dtype=np.float64).ravel()
    width, height = float(np.asarray(data["W"])), float(np.asarray(data["H"]))
    if matrix.shape != (3, 4) or lens.shape != (4,) or not (np.isfinite(matrix).all() and np.isfinite(lens).all()):
        raise ValueError("c2w: expected [3, 4] and intrinsics: expected [4] finite numbers")
    u, d, vt = np.linalg.svd(matrix[:, :3])
    if np.linalg.det(matrix[:, :3]) <= 0 or d[0] > 1.02 * d[2]:
        raise ValueError("c2w holds no rotation")
    return Frame(
        name=name,
        mask=None,
        rotation=OURS_FROM_OPENGL @ (u @ vt).T,
        center=matrix[:, 3],
        intrinsics=dict(zip(("fl_x", "fl_y", "cx", "cy"), lens.tolist(), strict=True)) | {"w": width, "h": height},
        fisheye=False,
    )
