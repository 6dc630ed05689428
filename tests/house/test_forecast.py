"""The forecast: against whole runs that were measured, and growing with what is asked for."""

import numpy as np

from graphgs.api import settings
from graphgs.forecast import forecast
from graphgs.options import Options

PHONE = np.tile([1080, 1920], (50, 1))


def test_a_measured_run_is_forecast_within_its_factor_of_two():
    """50 phone photos at 480 px, 2000 steps, two idle cores: 105 s of CPU for the poses, 146 s wall of training."""
    found = forecast(settings(Options(preset="preview", max_side=480, steps=2000)), PHONE, threads=2)
    assert 105 / 2 / 2 < found.structure_s < 105 / 2 * 2
    assert 146 / 2 < found.training_s < 146 * 2
    assert found.exhaustive == 1225
    assert 247 / 2 < found.pairs < 247 * 2


def test_more_of_anything_costs_more():
    base = settings(Options(preset="preview"))
    small = forecast(base, PHONE, threads=2)
    assert forecast(base, np.tile(PHONE, (2, 1)), threads=2).structure_s > small.structure_s
    assert forecast(settings(Options(preset="preview", steps=4000)), PHONE, threads=2).training_s > small.training_s
    assert forecast(base, PHONE, threads=1).training_s > small.training_s
    more = settings(Options(preset="preview", max_splats=1_000_000))
    assert forecast(more, PHONE, threads=2).memory_bytes > small.memory_bytes


def test_few_photos_have_no_more_pairs_than_there_are():
    assert forecast(settings(Options()), PHONE[:3], threads=2).pairs == 3


def test_one_line_says_it_for_the_device():
    found = forecast(settings(Options(preset="preview", max_side=480, steps=2000)), PHONE, threads=2)
    on_cpu, on_card = found.line("cpu"), found.line("cuda:0")
    assert f"{found.pairs} pairs" in on_cpu
    assert on_cpu != on_card
    assert found.card_s < found.training_s
