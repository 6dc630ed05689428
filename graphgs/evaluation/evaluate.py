"""The evaluation stage: render every held-out view, measure it against the photo, keep the pictures."""

import json
import math
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
import torch

from graphgs.evaluation.error_map import error_map
from graphgs.evaluation.exposure_fit import psnr_exposure_fitted
from graphgs.evaluation.metrics import psnr, ssim
from graphgs.evaluation.picture_names import picture_names
from graphgs.progress import Reporter
from graphgs.rendering.splats import TENSORS, Splats, render
from graphgs.scene.views import Views

EXACT = 100.0  # [dB] said of a rendering equal to its photo: JSON knows no infinity


@dataclass(frozen=True)
class ViewScore:
    """One test view."""

    name: str
    psnr: float  # dB
    ssim: float
    truth: str  # its pictures: POSIX paths below the folder of the pictures
    render: str
    error: str
    psnr_exposure_fitted: float | None = None  # dB of the right half, exposure fitted on the left; None = not measured


@dataclass(frozen=True)
class Evaluation:
    """Scores of the test views. The means are over the views that were measured; None without any."""

    views: tuple[ViewScore, ...]
    missing: tuple[str, ...] = ()  # test photos that could not be placed
    lpips: float | None = None  # None = not measured

    @property
    def psnr(self) -> float | None:
        """[dB] mean of the views' PSNR."""
        return float(np.mean([view.psnr for view in self.views])) if self.views else None

    @property
    def ssim(self) -> float | None:
        return float(np.mean([view.ssim for view in self.views])) if self.views else None

    @property
    def psnr_exposure_fitted(self) -> float | None:
        """[dB] mean over the views where it was measured. Stands beside `psnr`, never for it."""
        measured = [view.psnr_exposure_fitted for view in self.views if view.psnr_exposure_fitted is not None]
        return float(np.mean(measured)) if measured else None

    def save(self, folder: Path) -> None:
        """Write evaluation.json."""
        folder.mkdir(parents=True, exist_ok=True)
        means = {"psnr": self.psnr, "ssim": self.ssim, "psnr_exposure_fitted": self.psnr_exposure_fitted}
        text = json.dumps(means | asdict(self), indent=1)
        (folder / "evaluation.json").write_text(text + "\n", encoding="utf-8")

    @staticmethod
    def load(folder: Path) -> "Evaluation":
        saved = json.loads((folder / "evaluation.json").read_text(encoding="utf-8"))
        return Evaluation(tuple(ViewScore(**view) for view in saved["views"]), tuple(saved["missing"]), saved["lpips"])


def evaluate(
    splats: Splats,
    views: Views,
    folder: Path,  # of the pictures, normally eval/
    *,
    device: str,
    threads: int,  # write pictures while the next view renders
    reporter: Reporter,
) -> Evaluation:
    """PSNR and SSIM of the clamped float rendering against the 8-bit photo, masked pixels left out. Writes three
    pictures per test view into `folder` and nothing else. A view whose mask leaves nothing to compare counts as
    missing, with a warning. Held-out photos are read here and nowhere else, after training."""
    chosen = np.flatnonzero(views.is_test)
    splats = _finite(splats, reporter).to(device)
    pictures = picture_names(tuple(views.names[i] for i in chosen))
    scores, missing, writing = [], list(views.missing_test), []
    with ThreadPoolExecutor(max(1, threads), thread_name_prefix="evaluation-pictures") as pool:
        for done, (i, picture) in enumerate(zip(chosen, pictures, strict=True), 1):
            truth, mask = views.read(i)
            rendered = render_view(splats, views, i)
            files = [f"{picture}.{kind}.png" for kind in ("truth", "render", "error")]
            decibel, similarity = psnr(rendered, truth, mask), ssim(rendered, truth, mask)
            if math.isnan(decibel) or math.isnan(similarity):
                reporter.warn(
                    f"{views.names[i]}: its mask leaves nothing to compare, so this test view is not measured"
                )
                missing.append(views.names[i])
            else:
                fitted = psnr_exposure_fitted(rendered, truth, mask)
                fitted = None if math.isnan(fitted) else min(fitted, EXACT)
                scores.append(ViewScore(views.names[i], min(decibel, EXACT), similarity, *files, fitted))
            writing.append(pool.submit(_write, [folder / file for file in files], truth, rendered, mask))
            _raise_finished(writing)
            reporter.progress(done, len(chosen), f"{decibel:.2f} dB {views.names[i]}")
        for job in writing:
            job.result()
    result = Evaluation(tuple(scores), tuple(missing))
    reporter.event("evaluation", psnr=result.psnr, ssim=result.ssim, views=len(scores), missing=len(missing))
    return result


def render_view(splats: Splats, views: Views, i: int) -> np.ndarray:
    """[H, W, 3] float32 in [0, 1]: view i as the scene shows it."""
    width, height = (int(side) for side in views.sizes[i])
    with torch.no_grad():
        image = render(splats, views.Ks[i], views.viewmats[i], width, height).colors[0]
        return image.clamp(0.0, 1.0).cpu().numpy()


def _finite(splats: Splats, reporter: Reporter) -> Splats:
    """The Gaussians that can be drawn. Training saves no other, but a file may hold anything."""
    rows = [torch.isfinite(getattr(splats, name)).reshape(len(splats), -1).all(dim=1) for name in TENSORS]
    finite = torch.stack(rows).all(dim=0)
    if bool(finite.all()):
        return splats
    reporter.warn(f"{int((~finite).sum())} of {len(splats)} Gaussians are not finite, so they are not drawn")
    return splats.rows(finite)


def _write(files: list[Path], truth: np.ndarray, rendered: np.ndarray, mask: np.ndarray | None) -> None:
    files[0].parent.mkdir(parents=True, exist_ok=True)
    pictures = (truth, (rendered * 255.0 + 0.5).astype(np.uint8), error_map(truth, rendered, mask))
    for path, picture in zip(files, pictures, strict=True):
        path.write_bytes(cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]))[1])


def _raise_finished(writing: list[Future]) -> None:
    """A full disk ends the stage at the next view, not at the last."""
    for job in writing:
        if job.done():
            job.result()
