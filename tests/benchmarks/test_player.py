"""A page that plays a long run: how quick it is in a browser."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from offtrack.reports.run_page import report_html
from scenarios.results.log import Log
from scenarios.results.trailer_result import RunResult
from tests.browser import opened_page

READY, SCRUB = 1000.0, 16.0  # [ms]
SHOWN = """(() => { const begin = performance.now(); for (let k = 0; k < 200; k++) player.show((k * 37) % 120);
return (performance.now() - begin) / 200; })()"""


def test_a_long_run_is_ready_and_scrubbed_quickly(
    benchmark: Any, camera_run: RunResult, browser: Any, tmp_path: Path
) -> None:
    """120 s with 1200 pictures, made of a run's rows and pictures one after the other."""
    rows = np.resize(camera_run.log.rows, (12_000, camera_run.log.rows.shape[1]))
    for name, step in (("tick", 10.0), ("time", 0.01)):
        rows[:, camera_run.log.names.index(name)] = step * np.arange(len(rows))
    pictures = camera_run.frames
    frames = tuple(dataclasses.replace(pictures[k % len(pictures)], tick=100 * k) for k in range(1200))
    long = dataclasses.replace(camera_run, log=Log(camera_run.log.signals, rows), frames=frames)
    page = tmp_path / "report.html"
    page.write_text(report_html(long, long.summary()), encoding="utf-8")
    assert page.stat().st_size < 15e6
    with opened_page(browser, page) as opened:
        ready = float(opened.value("document.getElementById('player').dataset.ready"))
        assert opened.value("player.playback.runs[0].pictures.length") == 1200
        scrub = benchmark.pedantic(lambda: opened.value(SHOWN), rounds=1)
    benchmark.extra_info.update(ready_ms=ready, scrub_ms=scrub, megabytes=page.stat().st_size / 1e6)
    assert ready < READY
    assert scrub < SCRUB
