"""Steering laws on a vehicle that differs from their data sheet: mass, cornering stiffness and lag off by a fifth."""

from __future__ import annotations

import numpy as np
import pytest

from scenarios.loop.runner import run
from scenarios.options.scenario import load_scenario
from scenarios.results.metrics import rms

COURSE = ("course.turn_deg=100", "course.entry=22", "course.exit=5", "off_tracking=truth")
HEAVY_SOFT_SLOW = ("plant.mass_scale=1.2", "plant.cornering_stiffness_scale=0.8", "plant.steer_lag_scale=1.2")
LIGHT_STIFF_QUICK = ("plant.mass_scale=0.8", "plant.cornering_stiffness_scale=1.2", "plant.steer_lag_scale=0.8")


@pytest.mark.slow
@pytest.mark.parametrize("changes", [HEAVY_SOFT_SLOW, LIGHT_STIFF_QUICK], ids=["heavy", "light"])
@pytest.mark.parametrize(("law", "bar"), [("path_preview", 0.018), ("mpc", 0.012)], ids=["path_preview", "mpc"])
def test_the_follow_point_keeps_to_the_path_in_spite_of_a_model_error(
    law: str, bar: float, changes: tuple[str, ...]
) -> None:
    """Both estimate the slip of the axles and a disturbance, so that no offset remains.

    The bar for the roundabout is 0.06 m RMS. Without any error of the model they keep within 0.009 m and 0.006 m; twice
    that is what a fifth may cost. Axles that scrub lean on their suspensions, which shifts load between their wheels
    and takes side force of the tyres; path_preview does not know of it. Unsteered it would be metres.
    """
    off_tracking = run(load_scenario("roundabout", [*COURSE, f"trailer_steering={law}", *changes]), 1).log[
        "off_tracking_true"
    ]
    assert rms(off_tracking) < bar
    assert np.nanmax(np.abs(off_tracking)) < 4.2 * bar  # at the exit
