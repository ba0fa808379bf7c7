"""A sensor and an estimator from outside the packages, in a run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scenarios.assembly.trailer_run import assemble
from scenarios.loop.runner import run
from scenarios.options.scenario import load_scenario
from scenarios.results.trailer_result import error_of_estimate

FOLDER = Path(__file__).parent / "range_scanner"
SETTINGS = ("sensor=range_scanner:RangeScanner", "off_tracking=scan_matching:ScanMatching")


@pytest.mark.slow
def test_closed_loop_runs_by_settings_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Quarter of a roundabout, steered by the scans: import paths name both parts, nothing in the packages knows them.

    The hitch path is chained from some 28 motions of 1 to 4 cm (1 sigma) with partly correlated errors: a decimetre.
    """
    monkeypatch.chdir(FOLDER)
    result = run(load_scenario("roundabout", (*SETTINGS, "course.turn_deg=90")), 1)
    assert result.outcome == "completed"
    error, std = error_of_estimate(result), result.signal("off_tracking_std")
    valid = np.isfinite(error)
    assert valid.sum() > 200  # of some 250 scans; the first 14 m and a few with little scenery are lost
    assert np.sqrt(np.mean(error[valid] ** 2)) < 0.15  # [m]
    assert np.mean(std[valid]) < 0.3  # [m]
    assert np.abs(error[valid] / std[valid]).max() < 3.0


def test_the_estimator_refuses_another_sensor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(FOLDER)
    settings = ("sensor=reference_pose", "off_tracking=scan_matching:ScanMatching")
    with pytest.raises(ValueError, match="needs sensor = range_scanner:RangeScanner"):
        assemble(load_scenario("roundabout", settings), 1)
