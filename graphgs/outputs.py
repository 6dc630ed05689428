"""What a run leaves for its user: splat.ply, report.html, metrics.json, run.toml, graph.json, colmap/, eval/."""

import dataclasses
import os
import platform
import shutil
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from graphgs.config import to_toml
from graphgs.errors import PartialError
from graphgs.evaluation.evaluate import Evaluation
from graphgs.evaluation.report import (
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
    write_report,
)
from graphgs.export.colmap import write_colmap
from graphgs.export.ply import write_ply
from graphgs.memory import peak_rss_bytes
from graphgs.pipeline import Posed, Run, Trained
from graphgs.scene.origin import AT_ZERO, describe
from graphgs.stages import EVALUATION
from graphgs.structure.given_verdict import FITS, LARGEST_MEDIAN, HeldPoses
from graphgs.structure.pair_set import KIND_NAMES
from graphgs.structure.result import Structure
from graphgs.structure.rotation_only import LARGEST_TURNING_SHARE
from graphgs.structure.soundness import LARGEST_SHARE, LARGEST_STRENGTH
from graphgs.structure.world import plain
from graphgs.versions import installed_versions
from graphgs.workspace import write_json, write_text


@dataclass(frozen=True)
class Made:
    """The part of a run that training adds."""

    trained: Trained
    evaluation: Evaluation


def write_outputs(
    run: Run, posed: Posed, made: Made | None, *, command: str, partial: PartialError | None
) -> dict[str, Any]:
    """Write every output; returns what metrics.json holds. `partial`: why the photos are not all there."""
    output, started = run.workspace.output, time.perf_counter()
    run.reporter.info(f"writing {output}")
    if made is not None and made.trained.viewmats is not None:
        posed = posed.with_poses(made.trained.viewmats)
    versions = installed_versions()
    _write_settings(run, versions)
    posed.graph.save(output / "graph.json")
    write_colmap(
        output / "colmap", posed.views, posed.structure.reconstruction, posed.photos,
        origin=posed.structure.origin, threads=run.threads, reporter=run.reporter,
    )  # fmt: skip
    if made is not None:
        write_ply(made.trained.splats, output / "splat.ply", origin=posed.structure.origin)
        publish_pictures(run.workspace.cache / EVALUATION.folder, output / "eval")
    run.seconds["outputs"] = round(time.perf_counter() - started, 3)
    metrics = collect_metrics(run, posed, made, versions, partial)
    write_json(output / "metrics.json", metrics)
    write_report(output / "report.html", report_data(run, posed, made, metrics, command=command, partial=partial))
    return metrics


def collect_metrics(
    run: Run, posed: Posed, made: Made | None, versions: dict[str, str], partial: PartialError | None
) -> dict[str, Any]:
    """`status`: partial (not all photos are there), posed (stopped after the poses on request), or complete."""
    n = len(posed.photos.photos)
    evaluation = None if made is None else made.evaluation
    return {
        "status": "partial" if partial is not None else "posed" if made is None else "complete",
        "partial": None if partial is None else partial.message,
        "psnr": None if evaluation is None else evaluation.psnr,
        "ssim": None if evaluation is None else evaluation.ssim,
        "lpips": None,
        "psnr_exposure_fitted": None if evaluation is None else evaluation.psnr_exposure_fitted,
        "views": [] if evaluation is None else [_plain(view) for view in evaluation.views],
        "missing_views": list(posed.views.missing_test if evaluation is None else evaluation.missing),
        "num_splats": None if made is None else len(made.trained.splats),
        "steps_executed": None if made is None else made.trained.stats.steps_executed,
        "images": n,
        "registered": len(posed.structure.reconstruction.names),
        "rigs": [rig.record() for rig in posed.structure.rigs],
        "world": plain(posed.structure.world),
        "origin": list(posed.structure.origin),
        "given_poses": None if posed.held is None else posed.held.record(),
        "cautions": list(posed.structure.cautions),
        "lenses": _lenses(posed.structure),
        "groups": [{"name": group.name, "photos": list(group.photos)} for group in posed.structure.grouping.groups],
        "left_out": dict(posed.structure.unregistered),
        "skipped": {s.name: s.reason for s in posed.photos.skipped},
        "pairs_candidate": _pairs_tried(posed),
        "pairs_exhaustive": n * (n - 1) // 2,
        "pairs_verified": len(posed.graph.edges),
        "seconds": dict(run.seconds),
        "peak_rss_mb": round(peak_rss_bytes() / 2**20),
        "device": device_name(run.device),
        "versions": versions,
        "seed": run.config.run.seed,
    }


def report_data(
    run: Run, posed: Posed, made: Made | None, metrics: dict[str, Any], *, command: str, partial: PartialError | None
) -> ReportData:
    """The plain data the report is made from."""
    return ReportData(
        title=run.workspace.output.resolve().name,
        status="complete" if partial is None else "partial",
        command=command,
        cause="" if partial is None else partial.message,
        next_step="" if partial is None else partial.hint,
        created=time.strftime("%Y-%m-%d %H:%M"),
        device=metrics["device"],
        versions=metrics["versions"],
        settings=_settings(run),
        photos_used=posed.structure.reconstruction.names,
        photos_unused=tuple(
            [UnusedPhoto(s.name, s.reason) for s in posed.photos.skipped]
            + [UnusedPhoto(name, reason) for name, reason in posed.structure.unregistered]
        ),
        pairs=_pair_figures(posed),
        cameras=_camera_figures(posed),
        structure=_structure_figures(run, posed),
        training=None if made is None else _training_curve(made),
        tests=None if made is None else _held_out(made, run.workspace.output / "eval", posed),
        num_splats=metrics["num_splats"],
        steps_executed=metrics["steps_executed"],
        stage_seconds=metrics["seconds"],
        peak_rss_bytes=peak_rss_bytes(),
        warnings=tuple(run.reporter.warnings) + _notes(posed),
        outputs=_files(made is not None),
    )


def _notes(posed: Posed) -> tuple[str, ...]:
    """What a reader should know besides the warnings: which poses were used, and where the world's zero lies."""
    origin = posed.structure.origin
    return tuple(filter(None, (posed.photos.given_note, describe(origin) if origin != AT_ZERO else "")))


def device_name(device: str) -> str:
    if device.startswith("cuda"):
        import torch

        return f"{device} ({torch.cuda.get_device_name(device)})"
    return f"cpu ({platform.processor() or platform.machine()}, {os.cpu_count()} cores)"


def _write_settings(run: Run, versions: dict[str, str]) -> None:
    made_by = {"input": "" if run.source is None else str(run.source.resolve()), **versions}
    made_by |= {f"{stage}_key": key for stage, key in run.keys.items()}
    write_text(run.workspace.output / "run.toml", to_toml(run.config, made_by))


def _settings(run: Run) -> dict[str, dict[str, object]]:
    return dataclasses.asdict(run.config)


def _pair_figures(posed: Posed) -> PairFigures | None:
    pairs = posed.pairs
    if pairs is None:
        return None
    because = {name: int(((pairs.kinds & bit) != 0).sum()) for bit, name in KIND_NAMES.items()}
    if pairs.rings == "none":
        selector = "all pairs"
    else:
        selector = f"concentric nearest neighbours ({pairs.rings} rings), {pairs.filter} filter"
    because["look-alikes, to join groups and to test the poses"] = _pairs_tried(posed) - len(pairs.pairs)
    return PairFigures(
        candidate=_pairs_tried(posed),
        exhaustive=pairs.exhaustive,
        verified=len(posed.graph.edges),
        kept_because={name: count for name, count in because.items() if count},
        selector=selector,
    )


def _pairs_tried(posed: Posed) -> int | None:
    """Pairs that were matched: those chosen, and the look-alikes that matching adds. None where poses were given."""
    if posed.pairs is None:
        return None
    return len(posed.pairs.pairs) if posed.matches is None else posed.matches.candidates


def _camera_figures(posed: Posed) -> CameraFigures:
    graph = posed.graph
    return CameraFigures(
        names=graph.names,
        centers=graph.centers,
        rotations=graph.rotations,
        edges=graph.edges,
        inliers=graph.inliers,
        is_test=graph.is_test,
        importance=graph.importance(),
        unregistered=tuple(name for name, _ in posed.structure.unregistered),
        **_connections(posed.structure),
    )


def _connections(structure: Structure) -> dict[str, Any]:
    """What the picture of the cameras shows of the world and of photos and pairs that do not fit in."""
    world, diagnosis = structure.world, structure.diagnosis
    facts = {"compass": world is not None and world.compass, "unit": "" if world is None else "m"}
    if diagnosis is None:
        return facts
    groups = structure.grouping.groups
    shown = [PhotoGroup(g.name, len(g.photos), g.bridge.advice() if g.bridge else "") for g in groups]
    return facts | {
        "beside": diagnosis.beside([name for name, _ in structure.unregistered], structure.reconstruction.names),
        "objections": diagnosis.objections,
        "groups": tuple(shown) if len(groups) > 1 else (),
    }


def _structure_figures(run: Run, posed: Posed) -> StructureFigures:
    structure = posed.structure
    model, limits, agreed = structure.reconstruction, run.config.structure, structure.agreement
    checks = [_placed_check(structure, len(posed.photos.photos), limits.min_registered)]
    if agreed is not None:
        for name, value, limit in (
            ("pairwise rotation change, median", agreed.rotation_median_deg, limits.max_rotation_median_deg),
            ("pairwise rotation change, 99th percentile", agreed.rotation_p99_deg, limits.max_rotation_p99_deg),
        ):
            passed = value < limit or structure.upheld is not None
            checks.append(Check(name, f"{value:.2f}°", f"below {limit:g}°", passed))
        shift = 100 * agreed.largest_shift
        limit = 100 * limits.max_camera_shift
        passed = shift <= limit or structure.upheld is not None
        checks.append(Check("largest camera shift", f"{shift:.2f} %", f"at most {limit:g} % of the scene", passed))
    if structure.upheld is not None:
        place = structure.upheld
        checks.append(
            Check(f"scale {place.where}, which the other reconstruction has otherwise", f"{place.ratio:.3f}",
                  "1 within 3 %, by points placed from either side alone", True)
        )  # fmt: skip
    checks += [Check(*check) for check in (*_soundness_checks(structure), *_given_checks(posed.held))]
    calibration = structure.calibration
    focals = ", ".join(dict.fromkeys(f"{camera.focal_and_center[0]:.0f} px" for camera in model.cameras))
    return StructureFigures(
        errors=model.errors,
        track_lengths=model.track_lengths,
        method=structure.method,
        focal=focals if calibration is None else calibration.describe(),
        checks=tuple(checks),
    )


def _lenses(structure: Structure) -> dict[str, Any]:
    """The cameras as they came out, and what the photos determined of them."""
    found = {"cameras": [dataclasses.asdict(camera) for camera in structure.reconstruction.cameras]}
    if structure.calibration is None:
        return found
    record = structure.calibration.record()
    return found | {"determined": list(record["refine"]), "held": record["held"], "steps": record["steps"]}


def _placed_check(structure: Structure, usable: int, least: float) -> Check:
    """Measured against all usable photos; the limits are those of the group that is kept, and of the rest."""
    grouping, placed = structure.grouping, len(structure.reconstruction.names)
    kept = len(grouping.kept.photos)
    limit = f"{100 * least:.0f} % of the {kept} that hang together"
    if not grouping.joined:
        limit += f", and at most {grouping.tolerated} missing of other groups"
    passed = placed >= least * kept and grouping.is_whole
    return Check("photos placed", f"{placed} of {usable} ({100 * placed / max(usable, 1):.0f} %)", limit, passed)


def _soundness_checks(structure: Structure) -> list[tuple[str, str, str, bool]]:
    """(name, measured, limit, passed) of the figures that the matches judge the poses by."""
    if structure.diagnosis is None:
        return []
    sound = structure.diagnosis.soundness
    return [
        ("matches that contradict the poses", f"{100 * sound.contradicted_share:.1f} %",
         f"below {100 * LARGEST_SHARE:g} %", sound.contradicted_share < LARGEST_SHARE),
        ("strongest pair that contradicts them", f"{sound.strength:.2f}",
         f"below {LARGEST_STRENGTH:g} of the best pair", sound.strength < LARGEST_STRENGTH),
        ("pairs explained by a turn on the spot", f"{100 * sound.rotation_share:.0f} %",
         f"below {100 * LARGEST_TURNING_SHARE:g} %", sound.rotation_share < LARGEST_TURNING_SHARE),
    ]  # fmt: skip


def _given_checks(held: HeldPoses | None) -> Iterator[tuple[str, str, str, bool]]:
    """Likewise, of given poses and the points that came with them."""
    if held is None:
        return
    for figures, what in ((held.matches, "matches"), (held.observations, "observations of given points")):
        if figures is not None:
            yield (f"{what} that contradict the given poses", f"{100 * figures.contradicted:.1f} %",
                   f"below {100 * FITS:g} %", figures.contradicted < FITS)  # fmt: skip
            limit = figures.median_px / max(figures.median, 1e-12) * LARGEST_MEDIAN
            yield (f"median distance of {what} from the given poses", f"{figures.median_px:.2f} px",
                   f"at most {limit:.1f} px", figures.median <= LARGEST_MEDIAN)  # fmt: skip


def _training_curve(made: Made) -> TrainingCurve:
    curve = made.trained.stats.curve
    columns = {name: np.array([entry[name] for entry in curve]) for name in ("step", "loss", "num_splats")}
    return TrainingCurve(columns["step"], columns["loss"], columns["num_splats"])


def _held_out(made: Made, folder: Path, posed: Posed) -> HeldOutFigures:
    evaluation = made.evaluation
    views = tuple(
        HeldOutView(view.name, view.psnr, view.ssim, folder / view.truth, folder / view.render, folder / view.error)
        for view in evaluation.views
    )
    return HeldOutFigures(
        views, evaluation.psnr, evaluation.ssim, None, evaluation.missing, evaluation.psnr_exposure_fitted
    )


def _files(trained: bool) -> tuple[OutputFile, ...]:
    files = (
        OutputFile("colmap/", "undistorted photos and poses, COLMAP format", "COLMAP, and any splat trainer"),
        OutputFile("graph.json", "the camera graph, node-link form", "networkx"),
        OutputFile("metrics.json", "the figures of this page", "any JSON reader"),
        OutputFile("run.toml", "every setting in force", "graphgs run --config run.toml"),
        OutputFile("log.jsonl", "what happened, event by event", "any text editor"),
    )
    if not trained:
        return files
    splat = OutputFile("splat.ply", "the trained Gaussians", "any 3D Gaussian Splatting viewer")
    return (splat, *files, OutputFile("eval/", "held-out views: truth, render, error", "any image viewer"))


def _plain(view) -> dict[str, Any]:
    return {
        "name": view.name,
        "psnr": view.psnr,
        "ssim": view.ssim,
        "psnr_exposure_fitted": view.psnr_exposure_fitted,
    }


def publish_pictures(source: Path, target: Path) -> None:
    """The pictures of a stage under the output folder, as hard links where possible: the cache may be deleted."""
    partial = target.with_name(f".{target.name}.partial")
    if partial.exists():
        shutil.rmtree(partial)
    for path in sorted(source.rglob("*.png")):
        copy = partial / path.relative_to(source)
        copy.parent.mkdir(parents=True, exist_ok=True)
        try:
            os.link(path, copy)
        except OSError:
            shutil.copy2(path, copy)
    partial.mkdir(parents=True, exist_ok=True)
    if target.exists():
        shutil.rmtree(target)
    partial.rename(target)
