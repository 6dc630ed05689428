"""What a person reads where there is no terminal."""

import io

import pytest

from graphgs import console
from graphgs.console import RunReporter


@pytest.fixture
def spoken(monkeypatch):
    """(a reporter that speaks at every progress, its lines, a function that lets seconds pass)."""
    now = [100.0]
    monkeypatch.setattr(console, "PLAIN_INTERVAL_S", 0.0)
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])
    stream = io.StringIO()

    def wait(seconds):
        now[0] += seconds

    return RunReporter(stream=stream), lambda: stream.getvalue().splitlines(), wait


def test_the_time_left_follows_the_pace_since_the_work_began(spoken):
    reporter, lines, wait = spoken
    reporter.stage(4, 10, "Matching")
    reporter.progress(500, 1000, "matching")  # continued: these were done before
    wait(10)
    reporter.progress(600, 1000, "matching")
    assert lines()[-1].strip() == "600/1000 matching (10 s, 40 s left)"
    wait(30)
    reporter.progress(1000, 1000, "matching")
    assert lines()[-1].strip() == "1000/1000 matching (40 s)"
    wait(5)
    reporter.progress(0, 20, "bridges")
    assert lines()[-1].strip() == "0/20 bridges (45 s)"
    wait(5)
    reporter.progress(10, 20, "bridges")
    assert lines()[-1].strip() == "10/20 bridges (50 s, 5 s left)"
