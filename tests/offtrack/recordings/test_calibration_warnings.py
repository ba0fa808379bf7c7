"""What runs and recordings say about cameras that are turned, or not exposed together."""

from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from estimators.calibration.corrections import SelfCalibratedMotion
from estimators.calibration.epipolar import RightRotation
from estimators.estimates import lost_motion
from scenarios.results.run_warnings import calibration_warnings


def motion(tick: int, **changes: Any) -> SelfCalibratedMotion:
    plain = lost_motion(tick, tick - 100)
    values: dict[str, Any] = {field.name: getattr(plain, field.name) for field in fields(plain)}
    values |= {"right_rotation": RightRotation(0.0, float(np.radians(0.09)), 0.0), "miscalibrated": False}
    values |= {"right_rotation_std": RightRotation(1e-4, 1e-4, 1e-4), "right_delay": 0.0, "right_delay_std": 1e-3}
    return SelfCalibratedMotion(**(values | changes))


SOUND = [motion(100 * k) for k in range(9)]


@pytest.mark.parametrize(
    ("motions", "says"),
    [
        ([None, lost_motion(100, 0), *SOUND], []),
        ([*SOUND, motion(900, miscalibrated=True), motion(901, miscalibrated=True)], []),
        ([motion(k, right_delay=3e-3) for k in range(9)], []),  # 3 sigma
        (
            [motion(100 * k, miscalibrated=k >= 5) for k in range(10)],
            ["roll 0.00, yaw 0.09, pitch 0.00 deg", "5 of 10 motions", "or do this"],
        ),
        (
            [motion(k, right_delay=0.02 + 1e-3 * k) for k in range(4)],  # the newest significant value counts
            ["23.0 ms after the left one (standard deviation 1.0 ms)"],
        ),
        ([motion(k, right_delay=-0.02) for k in range(4)], ["before the left one"]),
    ],
)
def test_refuted_calibrations_and_late_images_are_warned_of(motions: list[Any], says: list[str]) -> None:
    """With their remedy; sound cameras and single doubtful motions are not."""
    lines = calibration_warnings(motions, "do this")
    assert len(lines) == bool(says)
    assert all(part in lines[0] for part in says)
