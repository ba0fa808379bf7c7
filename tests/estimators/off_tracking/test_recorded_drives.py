"""Fusion of recorded camera motions and signals on ice, and under faults of the cameras."""

import math
from dataclasses import replace

import numpy as np
import pytest

from estimators.estimates import Health, OffTracking
from estimators.off_tracking.signal_fusion import DIRECTION
from tests.estimators.recorded_drives import Drive, Row, load
from vehicle.frames import inverse, so3_exp, transform

ON_ICE = ("level_ice", "banked_ice", "pulling_away")
ONSET = 8000  # of the faults of cameras [ticks]


def errors(drive: Drive, estimates: dict[int, OffTracking], since: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Errors [m] and standard deviations [m] of all estimates that the law would be given."""
    known = [tick for tick, one in estimates.items() if tick >= since and one.health is not Health.LOST]
    known = [tick for tick in known if tick in drive.truth]
    error = np.array([estimates[tick].value - drive.truth[tick] for tick in known])
    return error, np.array([estimates[tick].std for tick in known])


@pytest.mark.parametrize("name", ON_ICE)
def test_sound_pictures_decide_where_tyres_slide(name: str) -> None:
    """Rear tyres of the tractor slip by up to 0.2 rad there: no motion is refused, and no sensor doubted."""
    drive = load(name)
    estimates = drive.estimates()
    error, std = errors(drive, estimates)
    by_camera, _ = errors(drive, drive.of_camera())
    assert np.sqrt(np.mean(error**2)) < 1.5 * np.sqrt(np.mean(by_camera**2)) + 0.003
    assert np.mean(np.abs(error) < 2.5 * std) > 0.95
    assert not any(one.bridged > 0.0 or one.doubts for one in estimates.values())


@pytest.mark.parametrize("name", ON_ICE)
def test_a_rig_that_is_turned_is_noticed_soon(name: str) -> None:
    """By 2 degrees about the vertical; also where tyres slide, which they do by other angles on each unit."""
    drive, turned = load(name), transform(so3_exp(np.array([0.0, 0.0, math.radians(2.0)])), np.zeros(3))

    def spoilt(row: Row) -> Row:
        one = row.motion
        X_PC = np.eye(4) if one is None else turned @ one.X_PC @ inverse(turned)
        return row._replace(motion=one and replace(one, X_PC=X_PC))

    estimates = drive._replace(rows=list(map(spoilt, drive.rows))).estimates()
    error, std = errors(drive, estimates)
    assert np.mean(np.abs(error) < 2.5 * std) > 0.85
    assert np.mean([DIRECTION in one.doubts for one in estimates.values()]) > 0.75


@pytest.mark.slow
def test_outages_on_ice_end_within_their_stated_uncertainty() -> None:
    """One and two seconds without images, begun every half second: also just before the tyres let go."""
    ratios: list[float] = []
    for drive in map(load, ON_ICE):
        for duration in (1000, 2000):
            for estimates in drive.in_outages(6000, 500, duration):
                error, std = errors(drive, estimates)
                ratios += list(error / std)
    assert np.mean(np.abs(ratios) < 2.5) > 0.95
    assert np.max(np.abs(ratios)) < 8.0


@pytest.mark.parametrize("name", ["turned_camera", "rolled_camera", "late_right_camera", "blackout"])
def test_faults_of_cameras_on_ice_are_noticed_and_stated(name: str) -> None:
    """On friction of 0.2; a pair that does not fit is lost for twenty seconds."""
    drive = load(name)
    estimates = drive.estimates()
    error, std = errors(drive, estimates, ONSET)
    assert any(estimates[tick].health is not Health.OK for tick in estimates if tick >= ONSET)
    assert np.abs(error / std).max() < 3.0
    assert np.abs(error).max() < 0.25  # [m]


def test_a_gyro_that_drifts_in_an_outage_is_stated_and_found() -> None:
    """By 2 deg/s per second from the moment on at which the cameras fail; the hitch angle contradicts it."""
    drive = load("blackout")

    def drifted(row: Row) -> Row:
        rates = ([0.0, 2e-3 * np.radians(max(0, one.tick - ONSET))] for one in row.signals)
        pairs = zip(row.signals, rates, strict=True)
        return row._replace(signals=tuple(replace(one, yaw_rates=one.yaw_rates + np.array(by)) for one, by in pairs))

    (estimates,) = drive._replace(rows=list(map(drifted, drive.rows))).in_outages(ONSET, 100_000, 2000)
    error, std = errors(drive, estimates)
    assert np.mean(np.abs(error) < 2.5 * std) >= 0.8  # it is within the noise of the hitch angle for 0.4 s of 2 s
    assert np.abs(error).max() < 0.15  # [m]
    assert any("gyro" in doubt for doubt in estimates[ONSET + 1000].doubts)
