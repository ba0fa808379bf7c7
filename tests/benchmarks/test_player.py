"""Pages that play runs: what they cost a run, and how quick they are in a browser."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from offtrack.reports.player.encoding import encoded
from offtrack.reports.player.playback import trailer_playback
from offtrack.reports.run_page import report_html
from scenarios.loop.runner import run
from scenarios.options.scenario import Scenario, load_any_scenario
from scenarios.results.log import Log
from scenarios.results.trailer_result import RunResult
from tests.browser import opened_page, running_browser

SHARE = 0.05  # of a run's wall time for its page
READY, SCRUB = 1000.0, 16.0  # [ms]


@pytest.fixture(scope="module")
def roundabout() -> tuple[RunResult, float]:
    """A run with cameras, and its processor time [s]."""
    scenario = load_any_scenario("roundabout")
    assert isinstance(scenario, Scenario)
    begin = time.process_time()
    result = run(scenario, 1, keep_frames=True)
    return result, time.process_time() - begin


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with running_browser() as started:
        yield started


def test_a_playback_costs_little_of_its_run(benchmark: Any, roundabout: tuple[RunResult, float]) -> None:
    """Both as processor time, in one process."""
    result, seconds = roundabout
    begin = time.process_time()
    benchmark.pedantic(lambda: encoded(trailer_playback(result)), rounds=1)
    share = (time.process_time() - begin) / seconds
    benchmark.extra_info["share"] = share
    assert share < SHARE


def test_a_long_run_is_ready_and_scrubbed_quickly(
    benchmark: Any, roundabout: tuple[RunResult, float], browser: Any, tmp_path: Path
) -> None:
    """120 s with 1200 pictures, made of the roundabout's rows and pictures one after the other."""
    result = roundabout[0]
    rows = np.resize(result.log.rows, (12_000, result.log.rows.shape[1]))
    for name, step in (("tick", 10.0), ("time", 0.01)):
        rows[:, result.log.names.index(name)] = step * np.arange(len(rows))
    frames = tuple(dataclasses.replace(result.frames[k % len(result.frames)], tick=100 * k) for k in range(1200))
    long = dataclasses.replace(result, log=Log(result.log.signals, rows), frames=frames)
    page = tmp_path / "report.html"
    page.write_text(report_html(long, long.summary()), encoding="utf-8")
    assert page.stat().st_size < 15e6
    with opened_page(browser, page) as opened:
        ready = float(opened.value("document.getElementById('player').dataset.ready"))
        assert opened.value("player.playback.runs[0].pictures.length") == 1200
        scrub = benchmark.pedantic(
            lambda: opened.value(
                "(() => { const begin = performance.now(); for (let k = 0; k < 200; k++) player.show((k * 37) % 120);"
                "return (performance.now() - begin) / 200; })()"
            ),
            rounds=1,
        )
    benchmark.extra_info.update(ready_ms=ready, scrub_ms=scrub, megabytes=page.stat().st_size / 1e6)
    assert ready < READY
    assert scrub < SCRUB
