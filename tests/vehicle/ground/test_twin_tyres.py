"""Twin tyres: two contact patches on one wheel, which scrub when the wheel turns about the vertical."""

import numpy as np
import pytest

from tests.vehicle.chains import linear_tyre, named, with_axles
from vehicle.combination.chain_forces import RollingWheel, WheelMotion, wheel_motion
from vehicle.combination.description import Vehicle
from vehicle.combination.layout import State, wheels
from vehicle.combination.multibody import Vector
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface
from vehicle.tyres import Planar

SPACING = 0.34  # [m]
LOAD, SPEED, STIFFNESS = 50e3, 2.0, 15.0

TYRE = linear_tyre(6.0, 2.0 * LOAD, damping=0.0)


def spaced(vehicle: Vehicle, distance: float) -> Vehicle:
    """The combination with twin tyres so far apart [m] on its driven axle."""
    return with_axles(vehicle, {}, {"twin_spacing": distance}, {}, {}, {})


@pytest.fixture(scope="module")
def twins(tractor_semitrailer: Vehicle) -> Vehicle:
    return spaced(tractor_semitrailer, SPACING)


def motion(vehicle: Vehicle, number: int, yaw_rate: float, outer: float, inner: float) -> WheelMotion:
    """A wheel that rolls freely with its middle, with given deflections of its patches along it."""
    wheel = wheels(vehicle)[number]
    state = RollingWheel(
        omega=SPEED / wheel.axle.wheel_radius,
        deflection=Planar(outer, 0.0),
        twin=Planar(inner, 0.0) if wheel.twin is not None else None,
        brake_windup=1.0,
        plane=Vector(1.0, 0.0),
        hub=Vector(SPEED, 0.0),
        yaw_rate=yaw_rate,
        travel=SPEED,
        load=LOAD,
        friction=0.8,
        acceleration=0.0,
        brake_deceleration=0.0,
        gear=1.0,
    )
    return wheel_motion(vehicle, wheel, state)


@pytest.mark.parametrize("number", [2, 3])
def test_turning_twins_resist_with_their_scrub(twins: Vehicle, number: int) -> None:
    """On a curve the patches slip by -+ (d / 2) r / v along the wheel: a moment of F_z C d^2 r / (4 v)."""
    vehicle, r = with_axles(twins, {"tyre": TYRE}), 1e-5  # [rad/s], so small that both patches roll equally fast
    slip = 0.5 * SPACING * r / SPEED  # of the left patch, whose ground passes more slowly in a left turn
    outer = (1.0 if number == 2 else -1.0) * STIFFNESS * slip
    turned = motion(vehicle, number, r, outer, -outer)
    assert turned.twin is not None
    assert (*turned.deflection, *turned.twin) == pytest.approx((0.0, 0.0, 0.0, 0.0), abs=1e-9)  # steady
    assert turned.moment_opposing == pytest.approx(LOAD * STIFFNESS * SPACING**2 * r / (4.0 * SPEED), rel=1e-6)
    assert turned.force.x == pytest.approx(0.0, abs=1e-6)


def test_twins_that_go_straight_are_one_tyre(twins: Vehicle, tractor_semitrailer: Vehicle) -> None:
    """Without yaw both patches have the slip of the wheel's middle and half its force."""
    one = motion(tractor_semitrailer, 2, 0.0, 0.05, 0.0)
    both = motion(twins, 2, 0.0, 0.05, 0.05)
    assert both.twin == one.deflection
    for name in ("omega", "deflection", "moment_opposing", "friction_used"):
        assert getattr(both, name) == pytest.approx(getattr(one, name), rel=1e-12)
    assert (both.force.x, both.force.y) == pytest.approx((one.force.x, one.force.y), rel=1e-12)
    assert both.relaxation.omega == pytest.approx(one.relaxation.omega, rel=1e-12)


def driven(vehicle: Vehicle, steer: float) -> State[FloatArray]:
    plant = Plant(vehicle, Surface(friction=0.8), engine="interpreted")
    state = plant.initial_state(Pose2(0.0, 0.0, 0.0), 2.0)
    state = plant.step(state, VehicleCommand(steer, 0.1, ()), 3000)
    return named(vehicle, state)


def test_scrub_widens_a_tight_turn_and_is_the_same_to_both_sides(twins: Vehicle, tractor_semitrailer: Vehicle) -> None:
    """At 30 degrees of steer twins resist the yaw; the front axle's slip makes up for it."""
    left, right, single = driven(twins, 0.5), driven(twins, -0.5), driven(tractor_semitrailer, 0.5)
    np.testing.assert_allclose(left.yaw_rate, -right.yaw_rate, rtol=1e-9)
    np.testing.assert_allclose(left.twin_x, right.twin_x[::-1], rtol=1e-6, atol=1e-12)
    assert 0.9 < left.yaw_rate[0] / left.v_x[0] / (single.yaw_rate[0] / single.v_x[0]) < 0.999
