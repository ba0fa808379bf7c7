"""A run's cameras calibrated with rendered boards: near the truth, and what its estimators are given."""

from __future__ import annotations

import math

import numpy as np
import pytest

from estimators.rigid_motion import rotation_vector
from scenarios.assembly import trailer_sensors
from scenarios.assembly.trailer_sensors import BoardCalibration, calibrated_with_boards
from sensors.camera.rig import RawStereoRig, StereoRig
from vehicle.frames import inverse

BARREL = (-0.12, 0.01, 0.0005, -0.0005, 0.0)


def small(baseline: float = 0.5) -> RawStereoRig:
    """Half the resolution of the usual cameras."""
    rig = StereoRig(
        facing="rear", width=672, height=240, hfov=math.radians(100.0), x=-14.0, y=0.0, z=4.2, baseline=baseline
    )
    return rig.raw(BARREL)


def calibrated(seed: int, reports: list[tuple[int, int]] | None = None) -> BoardCalibration:
    """From fewer pictures than a run takes: a third of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trailer_sensors, "_HELD", 14)
        patch.setattr(trailer_sensors, "_SURVEYED", 6)

        def report(done: float, total: float, note: str = "", /) -> None:
            if reports is not None:
                reports.append((int(done), int(total)))

        return calibrated_with_boards(small(), noise_std=2.0, rng=np.random.default_rng(seed), progress=report)


@pytest.fixture(scope="module")
def reports() -> list[tuple[int, int]]:
    """Progress reports of a calibration."""
    return []


@pytest.fixture(scope="module")
def calibration(reports: list[tuple[int, int]]) -> BoardCalibration:
    """One calibration for all tests."""
    return calibrated(1, reports)


@pytest.mark.slow
def test_the_pose_between_the_cameras_is_found_again(calibration: BoardCalibration) -> None:
    """To some 0.03 deg, which self-calibration takes care of later, and a millimetre in 0.5 m: 0.2 % of all depths."""
    error = inverse(small().X_ClCr) @ calibration.rig.X_ClCr
    assert np.abs(rotation_vector(error[:3, :3])).max() < 3.0 * calibration.rotation_std
    assert math.degrees(calibration.rotation_std) < 0.05  # 14 pairs at half the resolution
    assert np.linalg.norm(error[:3, 3]) < 1e-3
    assert calibration.rms < 0.15  # corners at a few hundredths of a pixel; misplaced ones would show [px]


def test_lens_and_mount_together_see_where_things_are(calibration: BoardCalibration) -> None:
    """A point 20 m behind the trailer is where the calibrated left camera's ray to its true image goes: within 2 cm.

    Principal point and pose on the trailer may each be off by more, as long as they make up for one another.
    """
    true, rig = small(), calibration.rig
    for x, y in ((-34.0, 0.0), (-34.0, 10.0), (-34.0, -10.0)):
        in_camera = inverse(true.X_SC) @ np.array([x, y, 1.0, 1.0])
        ray = rig.left.rays(true.left.project(in_camera[None, :3]))[0]
        seen = rig.X_SC @ np.append(in_camera[2] * np.append(ray, 1.0), 1.0)
        assert abs(seen[1] - y) < 0.02
        assert abs(seen[2] - 1.0) < 0.03


def test_it_is_no_copy_of_the_truth(calibration: BoardCalibration) -> None:
    """Corners are noisy, and so is what comes of them."""
    assert np.abs(calibration.rig.X_ClCr - small().X_ClCr).max() > 1e-6
    assert calibration.rig.left.cx != small().left.cx
    assert 0.0 < calibration.rotation_std < math.radians(0.1)


def test_progress_is_reported_picture_by_picture(calibration: BoardCalibration, reports: list[tuple[int, int]]) -> None:
    """Fourteen pairs and six surveyed boards."""
    assert reports == [(k + 1, 20) for k in range(20)]


def test_a_rig_that_no_board_fits_before_is_refused() -> None:
    """Cameras 5 m apart see nothing of the same board within 4.5 m."""
    with pytest.raises(ValueError, match="boards: no position found"):
        calibrated_with_boards(small(baseline=5.0), noise_std=2.0, rng=np.random.default_rng(1))
