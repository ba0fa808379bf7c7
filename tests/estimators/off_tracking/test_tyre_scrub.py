"""Scrub of tyres: closed forms of the hitch's force, and signs."""

import math
from dataclasses import replace

import numpy as np
import pytest

from estimators.off_tracking.tyre_scrub import TyreScrub
from sensors.messages import CombinationSignals
from tests.trailers import signals as readings
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.combination.linear import lateral_model
from vehicle.combination.loads import static_axle_loads

SEMITRAILER, B_DOUBLE = load_vehicle("uk_longer_semitrailer"), load_vehicle("b_double_steered")
SPEED = 3.0  # [m/s]


def signals(vehicle: Vehicle, curvature: float, gamma: float, angles: tuple[float, ...]) -> CombinationSignals:
    """Signals of units that all turn about one centre, at articulations of ``gamma`` [rad]."""
    units = len(vehicle.units)
    return readings(
        0,
        angles=np.array(angles),
        speed=SPEED,
        articulation=np.full(units - 1, gamma),
        yaw_rates=np.full(units, SPEED * curvature),
    )


@pytest.mark.parametrize("vehicle", [SEMITRAILER, B_DOUBLE], ids=lambda v: str(v.name))
def test_nothing_scrubs_straight_ahead(vehicle: Vehicle) -> None:
    """All axles roll."""
    assert TyreScrub(vehicle, len(vehicle.units) - 1).slip(signals(vehicle, 0.0, 0.0, (0.0, 0.0))) == 0.0


@pytest.mark.parametrize("vehicle", [SEMITRAILER, B_DOUBLE], ids=lambda v: str(v.name))
def test_the_mirrored_drive_has_the_opposite_slip(vehicle: Vehicle) -> None:
    """Left and right are alike."""
    scrub = TyreScrub(vehicle, len(vehicle.units) - 1)
    left = scrub.slip(signals(vehicle, 0.08, 0.5, (-0.3, -0.4)))
    assert abs(left) > 0.003
    assert scrub.slip(signals(vehicle, -0.08, -0.5, (0.3, 0.4))) == pytest.approx(-left, rel=1e-12)


def test_steered_axles_that_point_alike_push_the_hitch_by_the_moment_they_lack() -> None:
    """At small angles: axles at x with stiffness C, of which some are turned by delta, on a straight path.

    u = sum(C x delta) / sum(C x) balances the moments; the forces C (delta - u) go to the hitch, and with the arms of
    hitch and rear axle about the front axle to the rear axle's tyres.
    """
    delta = 0.01
    tractor, trailer = SEMITRAILER.units
    loads = static_axle_loads(SEMITRAILER)
    C, x = [], []
    for axle, load in zip(trailer.axles, loads[1], strict=True):
        C.append(float(axle.tyre.stiffness(0.5 * load).y) * load)
        x.append(axle.x)
    turned = np.array([delta if axle.steered else 0.0 for axle in trailer.axles])
    stiffness, places = np.array(C), np.array(x)
    u = np.sum(stiffness * places * turned) / np.sum(stiffness * places)
    force = np.sum(stiffness * (turned - u))  # of the trailer on the tractor
    front, rear = tractor.axles
    share = (front.x - tractor.rear_hitch[0]) / (front.x - rear.x)
    rear_stiffness = float(rear.tyre.stiffness(0.5 * loads[0][1]).y) * loads[0][1]
    slip = TyreScrub(SEMITRAILER, 1).slip(signals(SEMITRAILER, 0.0, 0.0, (delta, delta)))
    assert slip == pytest.approx(share * force / rear_stiffness, rel=1e-3)  # cos(delta) is 1
    assert abs(slip) > 1e-5


@pytest.mark.parametrize("steered", ["steer", "trailer_steer_1"])
def test_slow_steady_turns_slip_as_in_the_linear_model_of_the_vehicle(steered: str) -> None:
    """At walking pace forces of inertia vanish, and what slips the rear axle is scrub.

    The model has pneumatic trails and rolling resistance too, which make up a tenth.
    """
    speed, angle = 0.5, 1e-3
    model = lateral_model(SEMITRAILER, speed)
    v_y, *rates, gamma = -angle * np.linalg.solve(model.A, model.B[:, model.inputs.index(steered)])
    turning = readings(
        0,
        angles=np.array([0.0, angle if steered == "trailer_steer_1" else 0.0]),
        speed=speed,
        articulation=np.array([gamma]),
        yaw_rates=np.array(rates),
    )
    assert TyreScrub(SEMITRAILER, 1).slip(turning) == pytest.approx(v_y / speed, rel=0.12)


def test_slip_per_acceleration_is_that_of_the_linear_model_without_scrub() -> None:
    """A tractor whose one rear axle carries its load: F = m a at that axle, so slip = -load / (g C) per a.

    The semitrailer pushes at the hitch, ahead of the axle; to a fifth of the value.
    """
    axle, load = SEMITRAILER.units[0].axles[-1], static_axle_loads(SEMITRAILER)[0][-1]
    expected = -1.0 / (9.81 * float(axle.tyre.stiffness(0.5 * load).y))
    assert TyreScrub(SEMITRAILER, 1).per_acceleration() == pytest.approx(expected, rel=0.2)


@pytest.mark.parametrize("speed", [SPEED, -SPEED])
@pytest.mark.parametrize("bank", [0.05, -0.025])
def test_the_bank_is_what_the_accelerometer_feels_beyond_the_curve(bank: float, speed: float) -> None:
    """Straight and in a curve, forwards and in reverse; the lean of the body adds 7 %."""
    for curvature in (0.0, 0.08):
        turning = replace(
            signals(SEMITRAILER, curvature, 0.0, (0.0, 0.0)),
            speed=speed,
            yaw_rates=np.full(2, speed * curvature),
            lateral_acceleration=1.07 * (speed**2 * curvature + 9.81 * bank),
        )
        assert TyreScrub(SEMITRAILER, 1).bank(turning) == pytest.approx(9.81 * bank, abs=1e-6)


def test_scrub_at_rest_stays_finite() -> None:
    """Noise of a gyro at rest is no curvature."""
    still = signals(SEMITRAILER, 0.001, 0.3, (0.0, 0.0))
    slip = TyreScrub(SEMITRAILER, 1).slip(replace(still, speed=0.0))
    assert math.isfinite(slip)
    assert abs(slip) < 0.01
