"""The report: one self-contained HTML page about one run, finished or not."""

from graphgs.evaluation.report.data import (
    CameraFigures,
    Check,
    HeldOutFigures,
    HeldOutView,
    OutputFile,
    PairFigures,
    PhotoGroup,
    ReportData,
    StructureFigures,
    TrainingCurve,
    UnusedPhoto,
)
from graphgs.evaluation.report.page import write_report

__all__ = [
    "CameraFigures",
    "Check",
    "HeldOutFigures",
    "HeldOutView",
    "OutputFile",
    "PairFigures",
    "PhotoGroup",
    "ReportData",
    "StructureFigures",
    "TrainingCurve",
    "UnusedPhoto",
    "write_report",
]
