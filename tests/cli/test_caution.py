"""What the photos leave open is said last, where a person looks."""

from pathlib import Path
from types import SimpleNamespace

from graphgs import cli


def test_a_caution_stands_at_the_end(capsys):
    metrics = {
        "registered": 51, "images": 51, "psnr": None, "seconds": {"mapping": 7.0}, "peak_rss_mb": 900,
        "partial": None, "cautions": ["the scene may be stretched along the drive"],
    }  # fmt: skip
    cli._finished(SimpleNamespace(metrics=metrics, report_path=Path("report.html"), splat_path=Path("no.ply")), False)
    first, second, *_ = capsys.readouterr().out.splitlines()
    assert first == "done: 51 of 51 photos placed"
    assert second.strip() == "caution: the scene may be stretched along the drive"
