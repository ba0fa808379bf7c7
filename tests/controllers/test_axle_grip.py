"""Grip of a trailer's axles by its accelerometer."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from controllers.trailer_steering.actuators import AxleGrip, GripMemory
from controllers.trailer_steering.kinematics import TractorMotion
from sensors.messages import CombinationSignals
from tests.trailers import COMBINATION, signals
from vehicle.combination.description import GRAVITY
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.roll import roll_gradients
from vehicle.frames import FloatArray
from vehicle.tyres import Planar

VEHICLE = COMBINATION.vehicle
TRAILER = VEHICLE.units[1]
GRIP = AxleGrip(COMBINATION)
SPEED = 4.0  # [m/s]


def turning(friction: float, sound: float) -> CombinationSignals:
    """Signals of a bend to the left, with the first steered axle stuck straight and the second one at an angle [rad].

    The accelerometer reads what the side forces at this friction make of the moments about the hitch.
    """
    yaw_rate = SPEED / 12.0
    read = signals(
        0,
        speed=SPEED,
        steer=math.atan(VEHICLE.units[0].steered_axles[0].x * yaw_rate / SPEED),
        articulation=np.array([0.5]),
        yaw_rates=np.full(2, yaw_rate),
        angles=np.array([0.0, sound]),
    )
    angles, loads = np.array([0.0, 0.0, sound]), np.array(static_axle_loads(VEHICLE)[1])
    forces = [
        float(axle.tyre.steady_force(Planar(0.0, math.tan(angle - way)), 0.5 * load, friction).y) / (0.5 * load)
        for axle, angle, way, load in zip(TRAILER.axles, angles, travel(read), loads, strict=True)
    ]
    x = np.array([axle.x for axle in TRAILER.axles])
    moment = float((x * loads * np.cos(angles)) @ forces) / float(x @ loads)
    lean = 1.0 + GRAVITY * roll_gradients(VEHICLE)[1]
    return replace(read, lateral_acceleration=lean * GRAVITY * moment)


def travel(read: CombinationSignals) -> FloatArray:
    """Directions in which the axles travel [rad]."""
    motion = TractorMotion(COMBINATION).of_hitch(read)
    x = np.array([axle.x for axle in TRAILER.axles])
    return np.arctan((motion.v_y + x * motion.yaw_rate) / motion.v_x)


def learnt(read: CombinationSignals, seconds: float = 2.0) -> GripMemory:
    memory = GripMemory()
    for _ in range(round(seconds / 0.02)):
        memory = GRIP.measured(memory, read, 0.02)
    return memory


@pytest.mark.parametrize("friction", [0.2, 0.3, 0.8])
@pytest.mark.parametrize("sound", [-0.2, -0.5])
def test_friction_is_learnt_where_axles_slide(friction: float, sound: float) -> None:
    """After 8 m, to a third: forces of axles that slide to either side cancel, and the filter allows for other moments.

    Before, it believes in 0.45: twice the one, and half of the other.
    """
    memory = learnt(turning(friction, sound))
    assert memory.friction.friction == pytest.approx(friction, rel=0.35)


def test_an_axle_is_not_steered_beyond_the_slip_of_its_largest_side_force() -> None:
    """On friction of 0.3 that is 0.14 rad, on 0.8 nearly three times as much; angles within it are left alone."""
    for friction in (0.3, 0.8):
        read = turning(friction, -0.2)
        way = travel(read)[1:]
        memory = learnt(read)
        beyond = GRIP.limited(memory, way + 1.5) - way
        expected = 0.47 * friction
        assert beyond == pytest.approx([expected] * 2, rel=0.35)  # friction, and its standard deviation on top
        assert GRIP.limited(memory, way - 1.5) - way == pytest.approx(-beyond)
        assert GRIP.limited(memory, way + 0.9 * beyond) == pytest.approx(way + 0.9 * beyond)


def test_what_is_not_known_limits_nothing() -> None:
    """At rest no axle has a direction of travel; before any measurement a third of a radian is left."""
    far = np.array([0.5, -0.5])
    assert GRIP.limited(GRIP.measured(GripMemory(), signals(0), 0.02), far).tolist() == far.tolist()
    straight = GRIP.measured(GripMemory(), signals(0, speed=SPEED), 0.02)
    assert GRIP.limited(straight, 0.6 * far).tolist() == (0.6 * far).tolist()
