"""What the benchmark's gate decides, and what its baselines keep."""

import math
from importlib import import_module

import pytest

from bench import baselines
from bench.__main__ import WORKLOADS
from bench.metrics import Metric


@pytest.mark.parametrize(
    ("direction", "baseline", "value", "change"),
    [
        ("lower", 10, 12, 0.2),
        ("lower", 10, 5, -0.5),
        ("higher", 12, 10, 0.2),
        ("higher", 5, 10, -0.5),
        ("lower", 0, 0, 0),
        ("lower", 0, 8, math.inf),
        ("higher", 2, 0, math.inf),
        ("higher", 0, 2, -1),
    ],
)
def test_change_is_positive_when_worse(direction, baseline, value, change):
    assert Metric("m", value, "ms", direction, 0.1).change(baseline) == pytest.approx(change)


def test_a_metric_regresses_past_its_tolerance():
    assert not Metric("m", 10.9, "ms", "lower", 0.1).regressed(10)
    assert Metric("m", 11.1, "ms", "lower", 0.1).regressed(10)
    assert Metric("m", 8, "B", "lower", 0.1).regressed(0)


def metric(name, value=1.0, **options):
    return Metric(name, value, "ms", "lower", 0.1, **options)


@pytest.fixture
def stored(tmp_path, monkeypatch):
    """x measured by Warp 1, y by Warp 2, r against the yardstick abc."""
    monkeypatch.setattr(baselines, "FOLDER", tmp_path / "baselines")
    baselines.update_baseline("A processor, 2 CPUs", [metric("x", 1), metric("y", 2)], {"warp": "1"})
    baselines.update_baseline("A processor, 2 CPUs", [metric("y", 3), metric("r", 9, yardstick="abc")], {"warp": "2"})
    return lambda metrics, **options: baselines.load_baseline("A processor, 2 CPUs", metrics, **options)


def test_baselines_keep_what_did_not_run(stored):
    assert stored([metric("x"), metric("y"), metric("unknown")]) == {"x": 1, "y": 3}
    assert baselines.load_baseline("Another processor", [metric("x")]) == {}


def test_what_may_not_be_compared_has_no_baseline(stored):
    assert stored([metric("x"), metric("y")], warp="2") == {"y": 3}
    assert stored([metric("r", yardstick="abc")]) == {"r": 9}
    assert stored([metric("r", yardstick="def")]) == {}


@pytest.mark.parametrize("name", WORKLOADS)
def test_every_workload_can_be_run(name):
    assert callable(import_module(f"bench.{WORKLOADS[name].module}").run)
