"""The no-slip estimate: exact where nothing slips, askew by the slip angle where the tractor does."""

import math

import numpy as np
import pytest

from estimators.estimates import Health, OffTracking
from estimators.off_tracking.kinematic import KinematicOffTracking
from estimators.off_tracking.reference import ReferenceOffTracking
from sensors.messages import BodyPose
from tests.trailers import signals as readings
from vehicle.combination.description import load_vehicle
from vehicle.frames import Pose2, rotation_zyx, transform

VEHICLE = load_vehicle("b_double_steered")
WHEELBASE = VEHICLE.units[0].steered_axles[0].x
HITCHES = [unit.rear_hitch[0] for unit in VEHICLE.units[:2]]
FOLLOW = (8.3, 12.4)  # of both trailers [m]
AXLES = (8.3, 9.0)  # hitch to the axle that does not slip [m]
SPEED = 3.0  # [m/s]


def driven(
    unit: int, *, slip: float = 0.0, side: float = 1.0, seconds: float = 24.0, gap: tuple[int, int] = (0, 0)
) -> tuple[list[OffTracking], list[OffTracking]]:
    """Kinematic and exact estimates of a trailer; the tractor's rear axle slides by ``slip`` [rad] to the left."""
    estimator, reference = KinematicOffTracking(VEHICLE, unit, FOLLOW[unit - 1]), ReferenceOffTracking(FOLLOW[unit - 1])
    memory, exact = estimator.init(), reference.init()
    estimated, true = [], []
    X_WT, psi = Pose2(0.0, 0.0, 0.0), [0.0, 0.0]
    step = 5  # [ticks]
    for tick in range(0, round(1e3 * seconds), step):
        t = tick * 1e-3
        steer = side * 0.2 * math.sin(min(0.5 * max(t - 6.0, 0.0), 0.5 * math.pi))
        yaw_rates = [SPEED * math.tan(steer) / WHEELBASE]
        v = (SPEED * math.cos(slip), SPEED * math.sin(slip))
        at, heading = X_WT, X_WT.psi
        led = []
        for k in range(2):
            v = (v[0], v[1] + yaw_rates[k] * HITCHES[k])
            at = Pose2(at.x, at.y, heading) @ Pose2(HITCHES[k], 0.0, 0.0)
            gamma = heading - psi[k]
            c, s = math.cos(gamma), math.sin(gamma)
            v = (c * v[0] - s * v[1], s * v[0] + c * v[1])
            heading = psi[k]
            yaw_rates.append(v[1] / AXLES[k])
            led.append(at)
        if tick % 20 == 0 and not gap[0] <= tick < gap[1]:
            signals = readings(
                tick,
                angles=np.zeros(3),
                speed=SPEED * math.cos(slip),
                steer=steer,
                articulation=np.array([X_WT.psi - psi[0], psi[0] - psi[1]]),
                yaw_rates=np.array(yaw_rates),
            )
            memory, told = estimator.step(memory, signals)
            if told is not None:
                estimated.append(told)
        if tick % 100 == 0:
            place = led[unit - 1]
            body = transform(rotation_zyx(psi[unit - 1], 0.0, 0.0), np.array([place.x, place.y, 0.0]))
            exact, seen = reference.step(exact, BodyPose(tick=tick, X_WB=body))
            if seen is not None:
                true.append(seen)
        dt = step * 1e-3
        middle = X_WT.psi + 0.5 * yaw_rates[0] * dt + slip
        X_WT = Pose2(
            X_WT.x + SPEED * dt * math.cos(middle), X_WT.y + SPEED * dt * math.sin(middle), X_WT.psi + yaw_rates[0] * dt
        )
        psi = [p + r * dt for p, r in zip(psi, yaw_rates[1:], strict=True)]
    return estimated, true


@pytest.mark.parametrize("unit", [1, 2])
def test_without_slip_the_estimate_is_exact(unit: int) -> None:
    """Signals are all there is to know; 20 ms between them and the 5 ms steps of the motion here cost some mm."""
    estimated, true = driven(unit)
    assert [e.tick for e in estimated] == [e.tick for e in true]
    known = [(e, t) for e, t in zip(estimated, true, strict=True) if t.health is Health.OK]
    assert len(known) > 100
    assert max(abs(t.value) for _, t in known) > 0.5  # there is something to estimate
    assert {t.std for _, t in known} == {0.0}
    assert max(abs(e.value - t.value) for e, t in known) < 0.01
    assert max(abs(e.hitch_direction - t.hitch_direction) for e, t in known) < 0.003


def test_slip_of_the_tractor_turns_the_path_by_the_slip_angle() -> None:
    """1 deg to the left that the estimate does not know of is 1 deg of the path: 0.14 m at 8.3 m, straight ahead."""
    estimated, true = driven(1, slip=math.radians(1.0), seconds=6.0)
    assert estimated[-1].value - true[-1].value == pytest.approx(8.3 * math.tan(math.radians(1.0)), abs=0.003)


def test_the_stated_deviation_is_that_of_biases_that_last() -> None:
    """At 3 m/s 0.15 deg of direction over 8.3 m and 0.1 deg/s of yaw for 2.8 s; in the turn the scale adds a tenth."""
    direction, yaw_rate = math.radians(0.15) * 8.3, 0.5 * math.radians(0.1) * 8.3**2 / 3.0
    for seconds in (6.0, 20.0):
        estimated, _ = driven(1, seconds=seconds)
        assert estimated[-1].std == pytest.approx(math.hypot(direction, yaw_rate), rel=0.15)


@pytest.mark.slow
def test_swapping_left_and_right_flips_the_estimate() -> None:
    """Mirror symmetry pins all the signs at once; exact up to rounding."""
    left, right = driven(2)[0], driven(2, side=-1.0)[0]
    np.testing.assert_allclose([e.value for e in right], [-e.value for e in left], atol=1e-9)


def test_after_a_long_silence_the_path_begins_anew() -> None:
    """0.6 s without signals restart the path: lost until it reaches back far enough."""
    estimated, _ = driven(1, seconds=8.0, gap=(4000, 4600))
    before = [e for e in estimated if e.tick < 4000]
    after = [e for e in estimated if e.tick > 4600]
    assert before[-1].health is Health.OK
    assert after[0].health is Health.LOST
    assert after[-1].health is Health.OK


@pytest.mark.parametrize("unit", [0, 3])
def test_only_towed_units_have_an_off_tracking(unit: int) -> None:
    """Refused at construction, with what there is."""
    with pytest.raises(ValueError, match="1 to 2"):
        KinematicOffTracking(VEHICLE, unit, 8.3)
