"""Self-calibration in the closed loop: one key of the scenario, and what it found in the log."""

from __future__ import annotations

import numpy as np
import pytest

from scenarios.loop.runner import run
from scenarios.options.scenario import load_scenario

pytestmark = pytest.mark.usefixtures("worlds")
SMALL = ("rig.width=672", "rig.height=240", "course.length=20", "world.scenery_density=0.5")
TURNED = (-0.15, 0.10, 0.05)  # roll, yaw, pitch [deg]


@pytest.mark.slow
def test_a_turned_camera_is_found_and_logged() -> None:
    """Half the resolution of the usual rig: twice its errors, so 0.01 deg after 20 m."""
    settings = (*SMALL, "rig.self_calibration=true", f"rig.misrotation_deg={list(TURNED)}")
    log = run(load_scenario("constant-slip", settings), seed=2).log
    for name, true in zip(("roll", "yaw", "pitch"), TURNED, strict=True):
        found, std = (log[f"right_camera_{name}{end}"] for end in ("", "_std"))
        last = np.flatnonzero(np.isfinite(found))[-1]
        assert abs(np.degrees(found[last]) - true) < 0.01
        assert 0.0 < np.degrees(std[last]) < 0.02
