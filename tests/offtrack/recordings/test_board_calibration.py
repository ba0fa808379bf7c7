"""A run's cameras calibrated with rendered boards: near the truth, and what its estimators are given."""

import math

import numpy as np
import pytest

from estimators.rigid_motion import rotation_vector
from scenarios.assembly import trailer_sensors
from scenarios.assembly.trailer_sensors import calibrated_with_boards
from sensors.camera.rig import RawStereoRig, StereoRig
from vehicle.frames import inverse


def small(baseline: float = 0.5) -> RawStereoRig:
    """Half the resolution of the usual cameras."""
    place = {"x": -14.0, "y": 0.0, "z": 4.2, "baseline": baseline}
    rig = StereoRig(facing="rear", width=672, height=240, hfov=math.radians(100.0), **place)
    return rig.raw((-0.12, 0.01, 0.0005, -0.0005, 0.0))


@pytest.mark.slow
def test_cameras_are_found_again_near_the_truth(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rotation to some 0.03 deg, which self-calibration reduces later; a millimetre in 0.5 m: 0.2 % of all depths.

    A point 20 m behind the trailer is where the calibrated left camera's ray to its true image goes: within 2 cm.
    Principal point and pose on the trailer may each be off by more, as long as they make up for one another.
    """
    monkeypatch.setattr(trailer_sensors, "_HELD", 14)  # fewer pictures than a run takes: a third of the time
    monkeypatch.setattr(trailer_sensors, "_SURVEYED", 6)
    reports: list[tuple[float, float]] = []
    true = small()
    found = calibrated_with_boards(
        true,
        noise_std=2.0,
        rng=np.random.default_rng(1),
        progress=lambda done, total, *_: reports.append((done, total)),
    )
    assert reports == [(k + 1, 20) for k in range(20)]
    error = inverse(true.X_ClCr) @ found.rig.X_ClCr
    assert np.abs(rotation_vector(error[:3, :3])).max() < 3.0 * found.rotation_std
    assert 0.0 < math.degrees(found.rotation_std) < 0.05  # 14 pairs at half the resolution
    assert np.linalg.norm(error[:3, 3]) < 1e-3
    assert found.rms < 0.15  # corners at a few hundredths of a pixel; misplaced ones would show [px]
    assert np.abs(found.rig.X_ClCr - true.X_ClCr).max() > 1e-6  # corners are noisy: it is no copy
    assert found.rig.left.cx != true.left.cx
    for y in (0.0, 10.0, -10.0):
        in_camera = inverse(true.X_SC) @ np.array([-34.0, y, 1.0, 1.0])
        ray = found.rig.left.rays(true.left.project(in_camera[None, :3]))[0]
        seen = found.rig.X_SC @ np.append(in_camera[2] * np.append(ray, 1.0), 1.0)
        assert abs(seen[1] - y) < 0.02
        assert abs(seen[2] - 1.0) < 0.03


def test_a_rig_that_no_board_fits_before_is_refused() -> None:
    """Cameras 5 m apart see nothing of the same board within 4.5 m."""
    with pytest.raises(ValueError, match="boards: no position found"):
        calibrated_with_boards(small(baseline=5.0), noise_std=2.0, rng=np.random.default_rng(1))
