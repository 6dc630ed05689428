"""The evaluation stage: every test view is measured once, its pictures lie in the folder, the rest is said."""

import dataclasses
import json

import cv2
import numpy as np
import pytest
import torch

from graphgs.evaluation.error_map import IGNORED
from graphgs.evaluation.evaluate import Evaluation, ViewScore, evaluate, render_view
from graphgs.progress import Reporter
from graphgs.rendering.splats import SH_C0
from tests.support.tiny_scene import tiny_scene


class Told(Reporter):
    def __init__(self):
        self.steps, self.events, self.warnings = [], {}, []

    def warn(self, message):
        self.warnings.append(message)

    def progress(self, done, total, note=""):
        self.steps.append((done, total))

    def event(self, kind, **fields):
        self.events[kind] = fields


def run(scene, folder, *, device="cpu", threads=1, views=None, splats=None, reporter=None) -> Evaluation:
    return evaluate(
        splats or scene.truth,
        views or scene.views,
        folder,
        device=device,
        threads=threads,
        reporter=reporter or Reporter(),
    )


def pixels(path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_COLOR)[..., ::-1]


def test_the_true_scene_scores_as_high_as_8_bits_allow(tmp_path, device):
    scene, told = tiny_scene(tmp_path), Told()
    result = run(scene, tmp_path / "eval", device=device, reporter=told)
    assert [view.name for view in result.views] == ["00.png", "04.png", "08.png"]
    assert result.psnr > 55  # rounding to 8 bits alone: 10 log10(12 * 255^2) = 58.9 dB
    assert result.ssim > 0.999
    assert result.lpips is None
    assert told.steps == [(1, 3), (2, 3), (3, 3)]
    assert told.events["evaluation"]["views"] == 3


def test_the_pictures_are_the_photo_the_clamped_rendering_and_their_difference(tmp_path):
    scene = tiny_scene(tmp_path)
    brighter = dataclasses.replace(scene.truth, sh_coeffs=scene.truth.sh_coeffs + 0.8)
    result = run(scene, tmp_path / "eval", splats=brighter, threads=2)
    assert len(list((tmp_path / "eval").iterdir())) == 9
    for i, view in zip(np.flatnonzero(scene.views.is_test), result.views, strict=True):
        truth, _ = scene.views.read(i)
        rendered = render_view(brighter, scene.views, i)
        np.testing.assert_array_equal(pixels(tmp_path / "eval" / view.truth), truth)
        written = pixels(tmp_path / "eval" / view.render)
        assert np.abs(written - 255 * rendered).max() <= 0.5 + 1e-3
        assert rendered.max() == 1.0  # clamped: white is exceeded somewhere
        expected = -10 * np.log10(np.mean((rendered - truth / 255.0) ** 2))
        assert view.psnr == pytest.approx(expected, abs=1e-3)
        assert pixels(tmp_path / "eval" / view.error).max() > 100
    assert result.psnr == pytest.approx(np.mean([view.psnr for view in result.views]))
    assert result.psnr < 30


def test_scores_and_pictures_are_the_same_for_any_number_of_threads(tmp_path):
    scene = tiny_scene(tmp_path)
    one, two = (run(scene, tmp_path / str(n), threads=n) for n in (1, 2))
    assert one == two
    for path in (tmp_path / "1").iterdir():
        assert path.read_bytes() == (tmp_path / "2" / path.name).read_bytes()


def test_masked_pixels_do_not_count(tmp_path):
    scene = tiny_scene(tmp_path)
    mask = np.full((28, 40), 255, np.uint8)
    mask[:, :20] = 0
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    photo = pixels(tmp_path / "00.png").copy()
    photo[:, :20] = 255 - photo[:, :20]
    cv2.imwrite(str(tmp_path / "00.png"), photo[..., ::-1])
    spoiled = run(scene, tmp_path / "spoiled").views[0]
    views = dataclasses.replace(scene.views, masks=("mask.png", *scene.views.masks[1:]))
    masked = run(scene, tmp_path / "masked", views=views).views[0]
    assert spoiled.psnr < 30
    assert masked.psnr > 55
    assert tuple(pixels(tmp_path / "masked" / "00.error.png")[5, 5]) == IGNORED


def test_missing_and_no_test_views(tmp_path):
    scene = tiny_scene(tmp_path)
    nothing = dataclasses.replace(scene.views, is_test=np.zeros(9, bool), missing_test=("lost.jpg",))
    result = run(scene, tmp_path / "eval", views=nothing)
    assert result == Evaluation((), ("lost.jpg",))
    assert result.psnr is None
    assert result.ssim is None
    assert not (tmp_path / "eval").exists()


def test_names_in_folders_and_with_odd_characters_stay_in_the_folder(tmp_path):
    scene = tiny_scene(tmp_path)
    names = list(scene.views.names)
    names[0], names[4], names[8] = "../left/0?.jpg", "left/a.jpg", "left/a.png"
    result = run(scene, tmp_path / "eval", views=dataclasses.replace(scene.views, names=tuple(names)))
    assert [view.name for view in result.views] == [names[0], names[4], names[8]]
    assert [view.truth for view in result.views] == [
        f"{name}.truth.png" for name in ("_/left/0_", "left/a.jpg", "left/a.png")
    ]
    assert len(list((tmp_path / "eval").rglob("*.png"))) == 9


def test_an_evaluation_comes_back_from_its_file(tmp_path):
    scores = (ViewScore("é/a.jpg", 27.5, 0.9, "1", "2", "3", 28.5), ViewScore("b.jpg", 20.5, 0.7, "4", "5", "6"))
    saved = Evaluation(scores, ("c.jpg",))
    saved.save(tmp_path)
    assert Evaluation.load(tmp_path) == saved
    plain = json.loads((tmp_path / "evaluation.json").read_text(encoding="utf-8"))
    assert plain["psnr"] == pytest.approx(24.0)
    assert plain["lpips"] is None


def test_a_folder_that_cannot_be_written_is_an_error(tmp_path):
    scene = tiny_scene(tmp_path)
    (tmp_path / "eval").write_text("in the way")
    with pytest.raises(OSError, match="eval"):
        run(scene, tmp_path / "eval")


def test_a_view_masked_out_is_missing_and_said(tmp_path):
    scene = tiny_scene(tmp_path)
    cv2.imwrite(str(tmp_path / "mask.png"), np.zeros((28, 40), np.uint8))
    told = Told()
    views = dataclasses.replace(scene.views, masks=("mask.png", *scene.views.masks[1:]), missing_test=("lost.jpg",))
    result = run(scene, tmp_path / "eval", views=views, reporter=told)
    assert [view.name for view in result.views] == ["04.png", "08.png"]
    assert result.missing == ("lost.jpg", "00.png")
    assert "00.png" in told.warnings[0]


def test_a_broken_or_an_exact_rendering_still_gives_numbers(tmp_path):
    scene = tiny_scene(tmp_path)
    cv2.imwrite(str(tmp_path / "00.png"), np.zeros((28, 40, 3), np.uint8))
    unseen = dataclasses.replace(scene.truth, logit_opacities=torch.full((60,), -50.0))
    assert run(scene, tmp_path / "exact", splats=unseen).views[0].psnr == 100.0
    broken = dataclasses.replace(scene.truth, sh_coeffs=scene.truth.sh_coeffs * float("nan"))
    told = Told()
    result = run(scene, tmp_path / "broken", splats=broken, reporter=told)
    assert "60 of 60 Gaussians are not finite" in told.warnings[0]
    result.save(tmp_path)
    assert "NaN" not in (tmp_path / "evaluation.json").read_text()
    assert result.psnr < 100


def test_rendering_for_evaluation_keeps_no_gradient(tmp_path):
    scene = tiny_scene(tmp_path)
    splats = dataclasses.replace(scene.truth, means=scene.truth.means.clone().requires_grad_())
    image = render_view(splats, scene.views, 0)
    assert image.dtype == np.float32
    assert image.shape == (28, 40, 3)


def test_the_figure_with_fitted_exposure_stands_beside_the_headline(tmp_path):
    scene = tiny_scene(tmp_path)
    sh_coeffs = 0.6 * scene.truth.sh_coeffs
    sh_coeffs[:, 0] -= 0.2 / SH_C0  # colour = SH + 0.5, all of it times 0.6
    darker = dataclasses.replace(scene.truth, sh_coeffs=sh_coeffs)
    plain, dark = (run(scene, tmp_path / name, splats=s) for name, s in (("plain", scene.truth), ("dark", darker)))
    assert dark.psnr < plain.psnr - 20  # the headline forgives nothing
    assert dark.psnr_exposure_fitted > 50  # rounding to 8 bits is left
    dark.save(tmp_path)
    assert json.loads((tmp_path / "evaluation.json").read_text())["psnr_exposure_fitted"] == dark.psnr_exposure_fitted
    assert Evaluation.load(tmp_path) == dark
