"""Steering actuators: monitor of their faults, and grip of the axles."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from controllers.equations import settle
from controllers.trailer import Linkage, TrailerGeometry
from controllers.trailer_steering.actuators import ActuatorMemory, ActuatorMonitor, AxleGrip, GripMemory
from controllers.trailer_steering.kinematics import TractorMotion
from sensors.messages import CombinationSignals
from tests.trailers import COMBINATION, TWO_OF_THREE, signals
from vehicle.combination.description import GRAVITY
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.roll import roll_gradients
from vehicle.frames import FloatArray
from vehicle.tyres import Planar

PERIOD = 20  # of control [ticks]
ONSET, END = 3000, 5500  # of the faults [ticks]
RATE, LAG = TWO_OF_THREE.max_steer_rate, TWO_OF_THREE.actuator_lag
NOISE = math.radians(0.1)  # of the encoders [rad]

Moved = Callable[[FloatArray, FloatArray, float], FloatArray]  # angles, demands, time [s] -> angles a period later


def sound(angles: FloatArray, demand: FloatArray, _: float) -> FloatArray:
    return settle(angles, demand, PERIOD * 1e-3, lag=LAG, max_rate=RATE)


def weave(t: float) -> float:
    """Demand [rad] in and out of bends: 12 deg at 0.15 Hz, up to 11 deg/s."""
    return math.radians(12.0) * math.sin(2.0 * math.pi * 0.15 * t)


def monitored(
    faulty: Moved,
    *,
    until: int = 8000,
    axle: int = 0,
    demand: Callable[[float], float] = weave,
    trailer: TrailerGeometry = TWO_OF_THREE,
    monitor: ActuatorMonitor | None = None,
) -> ActuatorMemory:
    """Memory after a drive in which one axle is faulty for a time; nothing is done about it."""
    monitor, rng = monitor or ActuatorMonitor(trailer), np.random.default_rng(7)
    memory, angles = monitor.init(), np.full(2, demand(0.0))
    for tick in range(0, until, PERIOD):
        t = tick * 1e-3
        memory = monitor.measured(memory, tick, trailer.actuator_angles(angles + NOISE * rng.standard_normal(2)))
        sent = np.full(2, demand(t)) * trailer.steer_ratios
        memory = monitor.sent(memory, trailer.actuator_angles(sent))
        after = sound(angles, sent, t)
        if ONSET <= tick < END:
            after[axle] = faulty(angles, sent, t)[axle]
        angles = after
    return memory


def offset(angles: FloatArray, demand: FloatArray, t: float) -> FloatArray:
    return sound(angles, demand + math.radians(4.0), t)


HOME = math.radians(5.0) * PERIOD * 1e-3  # way of a dead actuator in a period [rad]
FAULTS: dict[str, Moved] = {
    "stuck": lambda angles, demand, t: angles,
    "dead": lambda angles, demand, t: angles - np.clip(angles, -HOME, HOME),
    "slow": lambda angles, demand, t: settle(angles, demand, PERIOD * 1e-3, lag=LAG, max_rate=0.25 * RATE),
    "offset": offset,
    "late": lambda angles, demand, t: sound(angles, np.full(2, weave(t - 0.4)), t),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_found_named_and_over(name: str) -> None:
    """The kind is that of the fault, the axle is axle 2 of the trailer, and the alarm ends with the fault.

    At 11 deg/s a stuck axle is 3 deg off after 0.3 s; a slow or late one takes longer. It is over a quarter of a second
    after its actuator is back at its demand, which takes a second from 20 deg at 20 deg/s.
    """
    findings = monitored(FAULTS[name]).findings
    assert {finding.axles for finding in findings} == {(2,)}
    assert ONSET < findings[0].tick < ONSET + 1000
    assert findings[-2].kind == name
    assert findings[-1].kind == "sound"
    assert END < findings[-1].tick < END + 1500


def test_an_offset_is_measured() -> None:
    """The offset is known to a tenth of a degree; with the noise of the encoders its filter leaves 0.1 deg, 1 sigma."""
    memory = monitored(offset, until=END)
    assert memory.offsets == pytest.approx([math.radians(4.0), 0.0], abs=math.radians(0.4))


@pytest.mark.parametrize("share", [0.5, 1.0, 1.8])
def test_a_sound_actuator_raises_no_alarm(share: float) -> None:
    """Also with a lag that is not that of the data sheet, in steering up to the rate limit."""

    def other(angles: FloatArray, demand: FloatArray, t: float) -> FloatArray:
        return settle(angles, demand, PERIOD * 1e-3, lag=share * LAG, max_rate=RATE)

    assert not monitored(other, until=ONSET + 2500, demand=lambda t: 1.6 * weave(t)).findings


def test_false_alarms_are_as_rare_as_derived() -> None:
    """Errors as assumed that last as long as the lag: alarms come at most as often as asked for, here every 2 s.

    Errors three times as large as assumed bring more; so the bound is one of the test, not of the data.
    """
    alarms = {}
    for level in (1.0, 3.0):
        monitor, rng, kept = (
            ActuatorMonitor(TWO_OF_THREE, between_alarms=2.0),
            np.random.default_rng(3),
            math.exp(-0.02 / LAG),
        )
        error, memory, count = np.zeros(2), monitor.init(), 0
        for tick in range(0, 20_000, PERIOD):
            std = level * math.radians(math.hypot(0.1, 0.2))
            error = kept * error + math.sqrt(1.0 - kept**2) * std * rng.standard_normal(2)
            memory = monitor.sent(monitor.measured(memory, tick, error), np.zeros(2))
            if memory.at_fault:
                count, memory = count + 1, monitor.init()
        alarms[level] = count
    assert alarms[1.0] <= 2 * 20 / 2.0
    assert alarms[3.0] > 2 * 20 / 2.0


def test_linked_axles_are_named_together() -> None:
    """One actuator turns both, the first by 0.6 of the second's angle; its fault concerns both."""
    linked = replace(TWO_OF_THREE, linkages=(Linkage((0, 1), (0.6, 1.0)),))
    monitor, memory = ActuatorMonitor(linked), ActuatorMonitor(linked).init()
    for tick in range(0, 3000, PERIOD):
        memory = monitor.measured(memory, tick, linked.actuator_angles(np.zeros(2)))
        memory = monitor.sent(memory, np.array([weave(tick * 1e-3)]))
    assert [(finding.axles, finding.kind) for finding in memory.findings] == [((2, 3), "stuck")]


def test_readings_that_are_no_numbers_or_old_are_passed_over() -> None:
    monitor = ActuatorMonitor(TWO_OF_THREE)
    memory = monitor.measured(monitor.init(), 100, np.zeros(2))
    assert monitor.measured(memory, 120, np.array([math.nan, 0.0])) is memory
    assert monitor.measured(memory, 100, np.ones(2)) is memory


def test_after_a_gap_the_model_starts_anew() -> None:
    """A second without readings: the angles may be anywhere."""
    monitor = ActuatorMonitor(TWO_OF_THREE)
    memory = monitor.sent(monitor.measured(monitor.init(), 0, np.zeros(2)), np.zeros(2))
    memory = monitor.measured(memory, 1000, np.full(2, 0.3))
    assert memory.expected == pytest.approx([0.3, 0.3])
    assert not memory.at_fault


# Grip


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
