"""Fault detection and isolation of the combination's own signals, on drives by kinematics with exact references."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from estimators.off_tracking.buffer import velocity
from estimators.off_tracking.parity import MotionReference
from estimators.off_tracking.signal_monitor import MonitorMemory, SignalMonitor
from sensors.messages import CombinationSignals
from tests.estimators.towed_drive import FRAME, VEHICLE, Errors, TowedDrive, towed_drive
from vehicle.clock import TICK

TRACTOR = VEHICLE.units[0]
FIXED = [axle.x for axle in TRACTOR.axles if not axle.steered]
WHEELBASE = TRACTOR.steered_axles[0].x - sum(FIXED) / len(FIXED)
MONITOR = SignalMonitor(VEHICLE, 1)
AS_OF_A_TRUCK = Errors(scale=0.005, gyro=math.radians(0.1), articulation=math.radians(0.1), noise=1.0)
SPEED, ANGLE, LEAD, OWN, STEER = MONITOR.names
LATE = 100  # of references [ticks]

Signals = Callable[[CombinationSignals], CombinationSignals]
Reference = Callable[[MotionReference], MotionReference | None]


def winding(t: float) -> float:
    """Yaw rate of a tractor at 4 m/s: straight for 6 s, then curves of 16 m radius, left and right [rad/s]."""
    return 0.25 * math.sin(0.4 * (t - 6.0)) if t > 6.0 else 0.0


def drive(errors: Errors = AS_OF_A_TRUCK) -> TowedDrive:
    return towed_drive(20.0, lambda t: 4.0, winding, errors=errors, seed=2)


DRIVE = drive()


def watched(
    signals: Signals = lambda one: one, reference: Reference = lambda one: one, of: TowedDrive = DRIVE
) -> tuple[MonitorMemory, list[CombinationSignals]]:
    """Memory at the end, and the corrected signals."""
    memory, out = MONITOR.init(), []
    for message in of.signals:
        faulty = signals(message)
        memory = MONITOR.received(memory, faulty)
        captured = message.tick - LATE
        if message.tick % FRAME == 0 and captured >= FRAME:
            seen = reference(seen_at(of, captured))
            memory = memory if seen is None else MONITOR.compared(memory, seen)
        out.append(MONITOR.corrected(memory, faulty))
    return memory, out


def seen_at(of: TowedDrive, tick: int) -> MotionReference:
    motion = of.motion(tick - FRAME, tick)
    return MotionReference(tick, tick - FRAME, *velocity(motion))


def from_(start: float, change: Signals, until: float = math.inf) -> Signals:
    """The fault within a time [s]."""
    return lambda one: change(one) if start <= one.tick * 1e-3 < until else one


def turned(one: CombinationSignals, degrees: float) -> CombinationSignals:
    return replace(one, articulation=one.articulation + math.radians(degrees))


def biased(one: CombinationSignals, unit: int, degrees: float) -> CombinationSignals:
    rates = one.yaw_rates.copy()
    rates[unit] += math.radians(degrees)
    return replace(one, yaw_rates=rates)


def at_fault(memory: MonitorMemory) -> list[str]:
    return [MONITOR.names[k] for k in memory.distrusted]


FAULTS: dict[str, tuple[Signals, str]] = {
    "no pulses": (lambda one: replace(one, speed=0.0), SPEED),
    "a third of the speed": (lambda one: replace(one, speed=one.speed / 3.0), SPEED),
    "shifted angle": (lambda one: turned(one, 5.0), ANGLE),
    "shifted angle to the other side": (lambda one: turned(one, -8.0), ANGLE),
    "stuck angle": (lambda one: replace(one, articulation=np.zeros(1)), ANGLE),
    "biased gyro": (lambda one: biased(one, 1, 3.0), OWN),
    "stuck gyro": (lambda one: replace(one, yaw_rates=np.array([one.yaw_rates[0], 0.0])), OWN),
    "stuck steer angle": (lambda one: replace(one, steer=0.0), STEER),
    "biased gyro of the tractor": (lambda one: biased(one, 0, 8.0), LEAD),
}


@pytest.mark.slow
@pytest.mark.parametrize("start", [0.0, 3.0, 11.0], ids=["from the start", "on a straight", "in a bend"])
@pytest.mark.parametrize(("fault", "name"), FAULTS.values(), ids=FAULTS.keys())
def test_the_signal_at_fault_is_found_and_no_other(fault: Signals, name: str, start: float) -> None:
    """And its corrected value is near the true one in the end, as far as the true one is steady."""
    memory, corrected = watched(from_(start, fault))
    assert at_fault(memory) == [name]
    assert all(finding.signal == name for finding in memory.findings)
    last, true = corrected[-20:], DRIVE.signals[-20:]
    if name == SPEED:
        assert np.mean([one.speed for one in last]) == pytest.approx(4.0, rel=0.05)
    if name == ANGLE:
        error = np.mean([a.articulation - b.articulation for a, b in zip(last, true, strict=True)])
        assert abs(error) < math.radians(2.0)  # what a direction of travel tells


def test_sound_signals_are_left_alone() -> None:
    """The very same messages, whatever their errors within data sheets."""
    for errors in (Errors(), AS_OF_A_TRUCK, Errors(scale=0.03, gyro=0.01, articulation=0.01, noise=6.0)):
        of = drive(errors)
        memory, corrected = watched(of=of)
        assert not memory.findings
        assert all(a is b for a, b in zip(corrected, of.signals, strict=True))


@pytest.mark.parametrize(
    "wrong",
    [
        pytest.param(lambda seen: seen._replace(v_x=0.0, v_y=0.0, yaw_rate=0.0), id="frozen"),
        pytest.param(lambda seen: seen._replace(yaw_rate=seen.yaw_rate + 0.1), id="turning"),
        pytest.param(lambda seen: seen._replace(v_x=1.5 * seen.v_x, v_y=1.5 * seen.v_y), id="too fast"),
        pytest.param(lambda seen: seen._replace(v_y=seen.v_y + 0.6), id="aside"),
    ],
)
@pytest.mark.parametrize("start", [3000, 11_000])
def test_a_wrong_reference_discredits_no_signal(wrong: Reference, start: int) -> None:
    """On a straight a frozen camera and a speed without pulses look alike; it is the camera that is doubted."""
    memory, _ = watched(reference=lambda seen: wrong(seen) if seen.tick > start else seen)
    assert not memory.findings


def test_a_signal_is_trusted_again_after_its_fault() -> None:
    """A second of small differences; a jump back counts as evidence for some time."""
    memory, corrected = watched(from_(8.0, FAULTS["shifted angle"][0], until=14.0))
    assert [finding.at_fault for finding in memory.findings] == [True, False]
    assert 14_000 < memory.findings[-1].tick < 19_000
    assert corrected[-1] is DRIVE.signals[-1]


def test_the_correction_stays_without_a_reference() -> None:
    """An angle that is shifted by 8 deg stays corrected while the camera sees nothing."""
    memory, corrected = watched(
        from_(3.0, lambda one: turned(one, 8.0)), lambda seen: seen if seen.tick < 9000 else None
    )
    assert at_fault(memory) == [ANGLE]
    error = corrected[-1].articulation[0] - DRIVE.signals[-1].articulation[0]
    assert abs(error) < math.radians(2.0)


def test_a_second_fault_is_found_beside_the_first() -> None:
    memory, _ = watched(lambda one: from_(11.0, FAULTS["no pulses"][0])(from_(4.0, FAULTS["biased gyro"][0])(one)))
    assert sorted(at_fault(memory)) == sorted([SPEED, OWN])


def test_messages_that_are_no_numbers_or_late_are_passed_over() -> None:
    message = DRIVE.signals[0]
    memory = MONITOR.received(MONITOR.init(), message)
    for bad in (message, replace(message, tick=20, speed=math.nan)):
        assert len(MONITOR.received(memory, bad).history) == 1


def test_front_wheels_that_slide_are_no_fault() -> None:
    """Ploughing straight ahead at full lock: they turn slower than the vehicle travels."""

    def ploughing(message: CombinationSignals) -> CombinationSignals:
        steer = message.steer + 0.5 * min(1.0, message.tick * 1e-4)
        c, s = math.cos(steer), math.sin(steer)
        rolled = message.speed * c * c + TRACTOR.steered_axles[0].x * float(message.yaw_rates[0]) * s * c
        return replace(message, steer=steer, speed=rolled)

    memory, _ = watched(ploughing)
    assert memory.findings == ()


def test_a_contradiction_lasts_until_the_signal_is_found() -> None:
    """Three seconds without a camera, in which a gyro begins to drift: no message between has its own value."""
    drifting = from_(8.0, lambda one: biased(one, 1, 2.0 * (one.tick * 1e-3 - 8.0)))
    memory, corrected = watched(drifting, lambda seen: None if 7500 < seen.tick < 11_000 else seen)
    (begins, both, _), (found, one, _), (ends, _, _) = memory.findings
    assert (both, one) == (f"{ANGLE} or its gyro", OWN)
    assert begins < 11_000 < ends == found
    assert MONITOR.doubts(memory) == (OWN,)
    between = [(a, b) for a, b in zip(corrected, DRIVE.signals, strict=True) if a.tick > begins]
    assert max(abs(float(a.yaw_rates[1] - b.yaw_rates[1])) for a, b in between) < math.radians(3.0)  # of 24


@pytest.mark.parametrize("start", [8.0, 13.0])
@pytest.mark.parametrize(
    ("change", "name"), [(lambda one: biased(one, 1, 5.0), OWN), (lambda one: turned(one, 5.0), ANGLE)]
)
def test_a_fault_that_begins_without_a_reference_is_made_up_for(change: Signals, name: str, start: float) -> None:
    """Its size is not measured: the other signals take its place, for the past, too."""
    dark = round(start / 1e-3)
    memory, corrected = watched(from_(start, change), lambda seen: seen if seen.tick < dark else None)
    assert at_fault(memory) == [name]
    found = memory.findings[0].tick
    assert dark < found < dark + 700
    since = [one for one in DRIVE.signals if one.tick >= dark - 100]
    again = MONITOR.corrected_again(memory, [from_(start, change)(one) for one in since])
    later = [(a, b) for a, b in zip(corrected, DRIVE.signals, strict=True) if found < a.tick < dark + 3000]
    past = [(a, b) for a, b in zip(again, since, strict=True) if dark < a.tick < dark + 3000]
    for pairs in (later, past):
        assert max(abs(float(a.yaw_rates[1] - b.yaw_rates[1])) for a, b in pairs) < math.radians(2.0)
        assert max(abs(float(a.articulation[0] - b.articulation[0])) for a, b in pairs) < math.radians(2.0)


def test_a_contradiction_that_is_over_for_the_relations_lasts_without_a_reference() -> None:
    """An angle that has moved away by 8 deg within a second, which the relations forget two seconds later."""
    moved = from_(8.0, lambda one: turned(one, 8.0 * min(1.0, one.tick * 1e-3 - 8.0)))
    memory, corrected = watched(moved, lambda seen: seen if seen.tick < 7500 else None)
    begins = memory.findings[0].tick
    assert MONITOR.doubts(memory) == (f"{ANGLE} or its gyro",)
    after = [(a, b) for a, b in zip(corrected, DRIVE.signals, strict=True) if a.tick > begins]
    assert max(abs(float(a.articulation[0] - b.articulation[0])) for a, b in after) < math.radians(3.0)


@pytest.mark.parametrize("ends", [math.inf, 14.0], ids=["for ever", "until it is free again"])
@pytest.mark.parametrize("start", [3.0, 8.0])
def test_an_angle_that_is_stuck_goes_on_without_a_reference(start: float, ends: float) -> None:
    """For ten seconds and more, with gyros that are wrong by 0.2 deg/s in opposite directions."""
    of = towed_drive(25.0, lambda t: 4.0, winding, errors=Errors(noise=1.0), seed=2)

    def faulty(one: CombinationSignals) -> CombinationSignals:
        return from_(start, FAULTS["stuck angle"][0], ends)(biased(biased(one, 0, 0.1), 1, -0.1))

    memory, corrected = watched(faulty, lambda seen: seen if seen.tick < 10_000 else None, of)
    assert at_fault(memory) == [ANGLE]
    blind = [(a, b) for a, b in zip(corrected, of.signals, strict=True) if a.tick > 10_000]
    assert max(abs(float(a.articulation[0] - b.articulation[0])) for a, b in blind) < math.radians(2.0)


def test_an_angle_that_is_stuck_goes_on_where_a_second_signal_fails() -> None:
    """The wheel speed, seconds after the last reference: what is known of the angle by then is kept."""
    stuck, still = from_(8.0, FAULTS["stuck angle"][0]), from_(14.0, FAULTS["no pulses"][0])
    memory, corrected = watched(lambda one: stuck(still(one)), lambda seen: seen if seen.tick < 7500 else None)
    assert sorted(at_fault(memory)) == sorted([ANGLE, SPEED])
    pairs = [(a, b) for a, b in zip(corrected, DRIVE.signals, strict=True) if a.tick > memory.findings[0].tick]
    assert max(abs(float(a.articulation[0] - b.articulation[0])) for a, b in pairs) < math.radians(2.0)


def test_wheels_without_pulses_keep_the_speed_of_before() -> None:
    """On a straight road no relation without a camera shows them, but a speed that jumps and then stays does."""
    memory, corrected = watched(from_(3.0, FAULTS["no pulses"][0]), lambda seen: seen if seen.tick < 3000 else None)
    assert at_fault(memory)[0] == SPEED
    found = memory.findings[0].tick
    assert 3000 < found < 3600
    assert all(abs(one.speed - 4.0) < 0.1 for one in corrected if one.tick > found)  # [m/s]


def test_in_bends_the_trailer_tells_the_speed_of_wheels_without_pulses() -> None:
    """Also that it stands: it stops in a bend of 16 m, without a camera, and pulls away again."""

    def speed(t: float) -> float:
        return min(4.0, 2.0 * max(abs(t - 15.0) - 1.0, 0.0))

    of = towed_drive(20.0, speed, lambda t: speed(t) / 16.0 if t > 4.0 else 0.0, errors=AS_OF_A_TRUCK, seed=2)
    memory, corrected = watched(
        from_(10.0, FAULTS["no pulses"][0]), lambda seen: seen if seen.tick < 9500 else None, of
    )
    assert at_fault(memory) == [SPEED]
    found = memory.findings[0].tick
    errors = [one.speed - speed(one.tick * TICK) for one in corrected if one.tick > found]
    assert np.abs(errors).max() < 2.0 * 0.5  # as late as half a second while it brakes [m/s]
    assert math.sqrt(np.mean(np.square(errors))) < 0.5


@pytest.mark.parametrize("least", [0.6, 1.2])
def test_wheels_whose_slow_pulses_are_not_seen_are_sound_at_a_stop(least: float) -> None:
    """Coils at pole wheels read 0 below some speed [m/s]: held as a fault without a camera, that speed lasts."""
    of = towed_drive(20.0, lambda t: min(4.0, abs(10.0 - t)), lambda t: 0.0, errors=AS_OF_A_TRUCK, seed=2)
    memory, _ = watched(lambda one: replace(one, speed=one.speed * (one.speed > least)), lambda seen: None, of)
    assert not memory.findings


@pytest.mark.parametrize("speed", [0.0, 4.0])
def test_a_speed_that_stays_the_same_is_at_fault_unless_it_is_0(speed: float) -> None:
    """Real wheels that stand, or creep, read exactly 0 [m/s]."""
    of = towed_drive(3.0, lambda t: speed, lambda t: 0.0, errors=AS_OF_A_TRUCK, seed=2)
    memory, _ = watched(lambda one: replace(one, speed=speed), lambda seen: None, of)
    assert at_fault(memory) == ([SPEED] if speed > 0.0 else [])


def test_the_size_of_a_speed_at_fault_is_known_where_the_tractor_slips() -> None:
    """On ice, by 9 deg: directions of travel contradict each other, too, but not the speed."""

    def speed(t: float) -> float:
        return 4.0 + 0.5 * max(0.0, t - 8.0)

    def slip(t: float) -> float:
        return 0.15 * math.sin(0.5 * max(0.0, t - 10.0))

    of = towed_drive(20.0, speed, lambda t: 0.0, slip, AS_OF_A_TRUCK, seed=2)
    memory, corrected = watched(from_(8.0, lambda one: replace(one, speed=4.0)), of=of)
    assert at_fault(memory) == [SPEED]
    late = [one for one in corrected if one.tick > 12_000]
    assert max(abs(one.speed / speed(one.tick * TICK) - 1.0) for one in late) < 0.15
