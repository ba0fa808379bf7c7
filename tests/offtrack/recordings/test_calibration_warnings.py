"""What runs and recordings say about cameras that are turned, or not exposed together."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

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


def test_sound_cameras_are_not_warned_of() -> None:
    """Nor single doubtful motions, motions of other odometries, or none at all."""
    sound = [motion(100 * k) for k in range(9)]
    assert calibration_warnings([None, lost_motion(100, 0), *sound], "do this") == ()
    assert calibration_warnings([*sound, *[motion(900 + k, miscalibrated=True) for k in range(2)]], "do this") == ()
    assert calibration_warnings([motion(k, right_delay=3e-3) for k in range(9)], "do this") == ()  # 3 sigma


def test_a_refuted_calibration_comes_with_its_remedy() -> None:
    """The angles as last estimated, the share of motions that suffer, and what to do."""
    motions = [*[motion(100 * k) for k in range(5)], *[motion(500 + 100 * k, miscalibrated=True) for k in range(5)]]
    (line,) = calibration_warnings(motions, "do this")
    assert "roll 0.00, yaw 0.09, pitch 0.00 deg" in line
    assert "5 of 10 motions" in line
    assert line.endswith("or do this")


def test_a_late_image_is_told_with_its_delay() -> None:
    """Late and early; the newest significant value counts."""
    (line,) = calibration_warnings([motion(k, right_delay=0.02 + 1e-3 * k) for k in range(4)], "do this")
    assert "23.0 ms after the left one (standard deviation 1.0 ms)" in line
    (line,) = calibration_warnings([motion(k, right_delay=-0.02) for k in range(4)], "do this")
    assert "before the left one" in line
