"""What a report is made from: plain data, so that the report knows no stage. None = this stage did not run."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

Status = Literal["complete", "partial", "failed"]


@dataclass(frozen=True)
class UnusedPhoto:
    """A photo of the input that is not part of the scene."""

    name: str
    reason: str


@dataclass(frozen=True)
class PairFigures:
    """How many image pairs were looked at."""

    candidate: int  # pairs matched
    exhaustive: int  # N (N - 1) / 2
    verified: int  # pairs that passed geometric verification
    kept_because: Mapping[str, int] = field(default_factory=dict)  # reason -> pairs; a pair may have several reasons
    selector: str = ""  # e.g. "concentric, frustum filter"


@dataclass(frozen=True)
class CameraFigures:
    """The camera graph: placed cameras, verified edges, photos that could not be placed."""

    names: tuple[str, ...]  # [N]
    centers: np.ndarray  # [N, 3] world
    rotations: np.ndarray  # [N, 3, 3] camera-from-world
    edges: np.ndarray  # [E, 2] int
    inliers: np.ndarray  # [E]
    is_test: np.ndarray  # [N] bool
    importance: np.ndarray | None = None  # [N] betweenness, any scale
    unregistered: tuple[str, ...] = ()  # [U]
    beside: np.ndarray | None = None  # [U] int, the camera that each of these shares most with; -1 = none
    objections: np.ndarray | None = None  # [K, 2] int, pairs whose matches contradict the poses
    compass: bool = False  # the world's x is east, y north, z up
    unit: str = ""  # of the world; empty: its own
    groups: tuple["PhotoGroup", ...] = ()  # where the photos fall into several, the kept one first


@dataclass(frozen=True)
class PhotoGroup:
    """Photos that hang together, apart from the rest."""

    name: str
    count: int
    advice: str = ""  # what would join it to the kept one


@dataclass(frozen=True)
class Check:
    """One acceptance figure beside its limit, both as text with units."""

    name: str
    value: str
    limit: str
    passed: bool


@dataclass(frozen=True)
class StructureFigures:
    """The fine reconstruction in figures."""

    errors: np.ndarray  # [P] mean reprojection error of a point, px
    track_lengths: np.ndarray  # [P] observations of a point
    method: str = ""  # the step of the ladder that made it
    focal: str = ""  # e.g. "1376 px (refined; EXIF said 1400 px)"
    checks: tuple[Check, ...] = ()


@dataclass(frozen=True)
class TrainingCurve:
    """Samples taken during training."""

    steps: np.ndarray  # [S] executed steps
    loss: np.ndarray  # [S]
    num_splats: np.ndarray  # [S]


@dataclass(frozen=True)
class HeldOutView:
    """One held-out view and its picture files."""

    name: str
    psnr: float  # dB
    ssim: float
    truth: Path
    render: Path
    error: Path


@dataclass(frozen=True)
class HeldOutFigures:
    """Held-out views; the means are over all of them."""

    views: tuple[HeldOutView, ...]
    psnr: float | None  # dB; None without test views
    ssim: float | None
    lpips: float | None = None  # None = not measured
    missing: tuple[str, ...] = ()  # test photos that could not be placed
    psnr_exposure_fitted: float | None = None  # dB of right halves, exposure fitted on left ones


@dataclass(frozen=True)
class OutputFile:
    """A file or folder the run wrote, and what opens it."""

    path: str
    what: str
    opens_with: str = ""


@dataclass(frozen=True)
class ReportData:
    """Everything the page shows."""

    title: str
    status: Status
    command: str = ""
    cause: str = ""  # partial or failed: what went wrong
    next_step: str = ""  # partial or failed: what to do about it
    created: str = ""
    device: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, Mapping[str, object]] = field(default_factory=dict)  # stage -> option -> value
    photos_used: tuple[str, ...] = ()
    photos_unused: tuple[UnusedPhoto, ...] = ()
    pairs: PairFigures | None = None
    cameras: CameraFigures | None = None
    structure: StructureFigures | None = None
    training: TrainingCurve | None = None
    tests: HeldOutFigures | None = None
    num_splats: int | None = None
    steps_executed: int | None = None
    stage_seconds: Mapping[str, float] = field(default_factory=dict)  # in the order they ran
    peak_rss_bytes: int | None = None  # children included
    warnings: tuple[str, ...] = ()
    outputs: tuple[OutputFile, ...] = ()
