"""Safeguards around a steering law: bad estimates and signals, reversing, failed actuators, wrong output; fallback."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.checked import LawError
from controllers.equations import settle
from controllers.trailer import Actuation, SteerCommand
from controllers.trailer_steering.kinematics import AxleGroup
from controllers.trailer_steering.safeguarded import Degradation, EstimateGuard, Safeguarded, SafeguardedCommand
from controllers.trailer_steering.signal_laws import CommandSteer, Fallback, FallbackName
from estimators.estimates import Health, OffTracking
from estimators.off_tracking.signal_monitor import Finding, SignalMonitor
from sensors.messages import CombinationSignals
from tests.trailers import COMBINATION, estimate, signals
from tests.trailers import TWO_OF_THREE as TRAILER
from vehicle.clock import TICK
from vehicle.frames import FloatArray

SPEED = 2.8  # [m/s]
PERIOD, CAMERA = 20, 100  # of steps and estimates [ticks]
RATE = TRAILER.max_steer_rate
WANTED = 0.2  # angle of the law by any estimate that it gets [rad]
COMMAND_STEER = Degradation(fallback="command_steer")  # the signals here are those of no real motion


class LawMemory(NamedTuple):
    ticks: tuple[int, ...] = ()  # of the good estimates
    actuation: Actuation | None = None


class Law(NamedTuple):
    """A law by a function of tick and estimate."""

    angles: Callable[[int, OffTracking | None], float]  # of both axles [rad]

    def init(self) -> LawMemory:
        return LawMemory()

    def actuated(self, memory: LawMemory, actuation: Actuation) -> LawMemory:
        return memory._replace(actuation=actuation)

    def step(
        self, memory: LawMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[LawMemory, SteerCommand]:
        good = None if off_tracking is None or off_tracking.health is Health.LOST else off_tracking
        given = () if good is None else (good.tick,)
        return memory._replace(ticks=memory.ticks + given), SteerCommand(angles=np.full(2, self.angles(tick, good)))


def to_the_path(tick: int, good: OffTracking | None) -> float:
    """WANTED times the sign of the estimate's value, straight without one."""
    return 0.0 if good is None else math.copysign(WANTED, good.value)


def trembling(tick: int, good: OffTracking | None) -> float:
    """The same, with a demand that goes to and fro at 6 deg/s on top."""
    return to_the_path(tick, good) + 0.05 * math.sin(2e-3 * tick)


Faulty = Callable[[OffTracking], OffTracking | None]  # None: it does not arrive
Actuators = Callable[[int, FloatArray, FloatArray], FloatArray]  # where they go, by tick, demand and angles


class Drive(NamedTuple):
    ticks: FloatArray  # (n,)
    commands: FloatArray  # (n, axles) [rad]
    given: tuple[int, ...]  # ticks of the estimates that the law got
    last: SafeguardedCommand
    angles: FloatArray  # (n, axles) [rad]
    known: Actuation | None  # as the law has received it last


def drive(
    faulty: Faulty,
    until: int,
    degradation: Degradation = COMMAND_STEER,
    *,
    articulation: float = 0.0,
    speed: Callable[[int], float] = lambda tick: SPEED,  # of the wheels [m/s]
    law: Callable[[int, OffTracking | None], float] = to_the_path,
    actuators: Actuators = lambda tick, demand, angles: demand,
) -> Drive:
    """A drive on a line, with an estimate of 0.1 s ago every 0.1 s: the path lies 0.1 m to the left."""
    safeguarded = Safeguarded(Law(law), "mine", TRAILER, COMBINATION, degradation)
    angle = articulation if math.isfinite(articulation) else 0.0
    motion = {"v_x": speed(0) * math.cos(angle), "v_y": speed(0) * math.sin(angle)}  # of the hitch
    memory, newest, commands, angles, course = safeguarded.init(), None, [], np.zeros(2), []
    ticks = np.arange(0, until, PERIOD)
    for tick in ticks.tolist():
        if tick % CAMERA == 0 and tick:
            newest = faulty(estimate(tick - CAMERA, value=0.1, **motion)) or newest
        read = signals(tick, articulation=np.array([articulation]), speed=speed(tick), angles=angles)
        memory, command = safeguarded.step(memory, tick, newest, read)
        course.append(angles)
        goal = actuators(tick, command.angles, angles)
        angles = settle(angles, goal, PERIOD * 1e-3, lag=TRAILER.actuator_lag, max_rate=RATE)
        commands.append(command.angles)
    given, known = memory.law
    return Drive(ticks.astype(np.float64), np.array(commands), given, command, np.array(course), known)


def within(start: int, end: int, change: Faulty) -> Faulty:
    """The fault, from estimates captured at ``start`` on until ``end`` [ticks]."""
    return lambda seen: change(seen) if start <= seen.tick < end else seen


FAULTS: dict[str, Faulty] = {
    "lost": lambda seen: replace(seen, health=Health.LOST, value=0.0, std=math.inf),
    "dropped": lambda seen: None,
    "degraded beyond use": lambda seen: replace(seen, health=Health.DEGRADED, std=1.0),
    "too old": lambda seen: replace(seen, tick=seen.tick - 1000),
    "frozen": lambda seen: replace(seen, v_x=0.0),
    "spinning": lambda seen: replace(seen, yaw_rate=0.5),
    "not a number": lambda seen: replace(seen, value=math.nan),
}


LOST_FOR_GOOD = within(3000, 99999, FAULTS["lost"])


def test_good_estimates_leave_the_law_alone() -> None:
    ticks, commands, given_estimates, last, *_ = drive(lambda seen: seen, 3000)
    assert given_estimates[:3] == (0,) * 3
    assert (commands[ticks >= 800] == WANTED).all()  # 0.2 rad at 20 deg/s take 0.57 s from the first estimate on
    assert not last.by_fallback
    assert not last.signal_findings
    assert not last.actuator_findings


@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS.keys())
def test_a_fault_is_bridged_and_then_ends_with_straight_wheels_at_a_slow_rate(fault: Faulty) -> None:
    """For a second the law goes on with the last good estimate; at this speed that is less than a quarter of 14 m.

    Straight ahead the fallback has nothing to steer. Its rate begins at 0.05 rad/s and grows by that in a second.
    """
    ticks, commands, given_estimates, last, *_ = drive(within(3000, 99999, fault), 9000)
    held = (ticks > 1000) & (ticks <= 4000)
    assert (commands[held] == WANTED).all()  # the last good one arrived at 3.0 s
    assert max(given_estimates) < 3000
    assert last.by_fallback
    letting_go = ticks > 4000
    since = (ticks[letting_go] - 4000.0) * 1e-3
    rates = -np.diff(commands[:, 0])[letting_go[1:]] / 0.02
    assert (rates <= 0.05 * (1.0 + since) + 1e-9).all()
    assert (commands[ticks > 7000] == 0.0).all()  # 0.05 (t + t^2/2) = 0.2 after 2 s


@pytest.mark.parametrize("fault", [FAULTS[name] for name in FAULTS if name != "frozen"])  # that one: see below
def test_the_law_takes_over_again_without_a_jerk(fault: Faulty) -> None:
    """Half a second of good estimates, then from where the axles are at the slow rate; all is as before in the end."""
    ticks, commands, _, last, *_ = drive(within(3000, 8000, fault), 14000)
    assert (commands[(ticks > 7000) & (ticks < 8500)] == 0.0).all()
    rates = np.diff(commands[:, 0])[ticks[1:] > 8000] / 0.02
    assert rates[rates > 0.0][0] == pytest.approx(0.05, rel=0.03)  # it grows by a fiftieth in a step
    assert rates.min() >= 0.0
    assert rates.max() <= 0.05 * (1.0 + 2.0)  # it is there after 2 s: 0.05 (t + t^2/2) = 0.2
    assert (commands[-10:] == WANTED).all()
    assert not last.by_fallback


def test_a_freeze_leaves_a_gap_in_the_path_that_has_to_be_passed() -> None:
    """5.6 m in 2 s are missing, of which some is forgotten meanwhile; at 1.4 m the path is good again.

    d = 14 (1 - exp(-5.6/14)) = 4.6 m, and 14 ln(4.6/1.4) = 16.7 m until then.
    """
    ticks, commands, given_estimates, *_ = drive(within(3000, 5000, FAULTS["frozen"]), 16000)
    missing = 14.0 * (1.0 - math.exp(-5.6 / 14.0))
    passed = 5000 + 1000.0 * 14.0 * math.log(missing / 1.4) / SPEED
    taken = [tick for tick in given_estimates if tick >= 5000]
    assert taken[0] == pytest.approx(passed, abs=200.0)  # the law sees it half a second before it steers
    assert (commands[(ticks > 7000) & (ticks < passed)] == 0.0).all()
    assert (commands[-10:] == WANTED).all()


def test_a_wheel_speed_that_fails_does_not_cost_a_sound_estimate() -> None:
    """It falls to zero at once, which no vehicle does; estimates and yaw rates go on. It is named.

    The axles stay straight, as the signals are those of a straight drive.
    """
    _, _, given_estimates, last, *_ = drive(
        lambda seen: seen,
        8000,
        Degradation(),
        law=lambda tick, good: 0.0,
        speed=lambda tick: SPEED if tick < 3000 else 0.0,
    )
    missed = set(range(0, 7900, CAMERA)) - set(given_estimates)
    assert missed <= {2900, 3000}  # until it is clear which of the two is wrong
    assert not last.by_fallback
    assert [finding.signal for finding in last.signal_findings] == ["wheel speed"]


@pytest.mark.parametrize("found", [2000, 3300, None])
def test_a_signal_that_is_found_at_fault_meanwhile_ends_the_hold(found: int | None) -> None:
    """The law has foreseen by it how the trailer goes on; one that was found before is corrected."""
    guard, read = EstimateGuard(TRAILER, COMBINATION, COMMAND_STEER), signals(3500, speed=SPEED)
    memory, _ = guard.estimate_checked(guard.init(), 3000, estimate(2900, value=0.1, v_x=SPEED), read)
    findings = () if found is None else (Finding(found, "wheel speed", True),)
    memory = memory._replace(monitor=memory.monitor._replace(findings=findings))
    assert guard.estimate_checked(memory, 3500, None, read)[0].law_steers == (found != 3300)


@pytest.mark.parametrize(("std", "share"), [(0.05, 0.9), (0.15, 0.5)])
def test_an_estimate_is_believed_as_far_as_it_is_better_than_none(std: float, share: float) -> None:
    """Least squares of the path's 0.1 m with the 0.15 m that are usual without an estimate."""
    run = drive(lambda seen: replace(seen, std=std), 3000, law=lambda tick, good: good.value if good else 0.0)
    assert run.commands[-1] == pytest.approx([0.1 * share] * 2)


def jumping(seen: OffTracking) -> OffTracking:
    """An estimate a metre off, of the other sign, which would throw the axles about."""
    return replace(seen, value=-0.9)


def test_an_implausible_jump_is_ignored() -> None:
    ticks, commands, given_estimates, *_ = drive(within(3000, 3100, jumping), 6000)
    assert 3000 not in given_estimates
    assert (commands[ticks > 1000] == WANTED).all()


def test_a_jump_that_stays_is_believed_after_a_while() -> None:
    """It is the old path that was wrong, then; the axles go over to the new one at the slow rate."""
    ticks, commands, given_estimates, *_ = drive(within(3000, 99999, jumping), 10000)
    assert min(tick for tick in given_estimates if tick >= 3000) == pytest.approx(3000 + 600, abs=100)
    assert np.abs(np.diff(commands[:, 0]))[ticks[1:] > 3000].max() / 0.02 <= 0.25
    assert (commands[-10:] == -WANTED).all()


def test_a_slow_change_is_no_jump() -> None:
    """A path that comes nearer as the trailer turns to it is what the motion says; 0.3 rad make 0.084 m a frame."""
    turned = estimate(0, value=0.1, path_tangent=0.3)
    nearing = within(
        0, 99999, lambda seen: replace(turned, tick=seen.tick, value=0.1 + 0.3093 * SPEED * seen.tick * 1e-3)
    )
    given_estimates = drive(nearing, 5000, Degradation(max_jump=0.02)).given
    assert sorted(set(given_estimates)) == list(range(0, 4800 + 1, CAMERA))


def test_in_a_turn_the_axles_go_over_to_command_steer() -> None:
    """With an articulation of 20 deg straight wheels cut in by metres; the sensors of the combination know."""
    commands = drive(LOST_FOR_GOOD, 12000, articulation=math.radians(20.0)).commands
    alone = CommandSteer(TRAILER, combination=COMBINATION)
    memory = alone.init()
    for tick in range(0, 12000, PERIOD):
        memory, command = alone.step(
            memory, tick, None, signals(tick, articulation=np.array([math.radians(20.0)]), speed=SPEED)
        )
    assert np.abs(command.angles).max() > math.radians(5.0)
    np.testing.assert_allclose(commands[-1], command.angles, atol=1e-12)


def test_at_speed_the_fallback_is_straight_and_comes_earlier() -> None:
    """Two frames may be missing, 0.3 s; command steer would make a lively trailer livelier."""
    ticks, commands, *_ = drive(LOST_FOR_GOOD, 9000, articulation=0.1, speed=lambda tick: 25.0)
    assert (commands[(ticks > 1000) & (ticks <= 3300)] == WANTED).all()
    assert (commands[(ticks > 3340) & (ticks < 3500)] < WANTED).all()
    assert not commands[-1].any()


def test_a_first_estimate_that_does_not_come_is_not_waited_for() -> None:
    """The path is long enough after 14 m, 5 s; a hold and a gap later command steer has the axles."""
    ticks, commands, _, last, *_ = drive(FAULTS["lost"], 12000, articulation=math.radians(20.0))
    assert last.by_fallback
    assert not commands[ticks < 6300].any()
    assert np.abs(commands[-1]).max() > math.radians(5.0)
    assert np.abs(np.diff(commands[:, 0])).max() / 0.02 <= 0.05 * (1.0 + 4.0)  # it is there after 4 s


def test_a_path_that_begins_by_dead_reckoning_is_not_given_to_the_law() -> None:
    """What a law learns from it, as the slip, is the error of a signal."""
    seen: list[OffTracking | None] = []

    class Watching(Law):
        def step(
            self, memory: LawMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
        ) -> tuple[LawMemory, SteerCommand]:
            seen.append(off_tracking)
            return super().step(memory, tick, off_tracking, signals)

    safeguarded = Safeguarded(Watching(to_the_path), "mine", TRAILER, COMBINATION, COMMAND_STEER)
    memory = safeguarded.init()
    for tick in range(100, 3000, PERIOD):
        captured = tick - tick % CAMERA
        newest = estimate(captured, value=0.1, v_x=SPEED, v_y=0.0)
        if captured <= 2000:
            bridged = 0.1 if captured < 1500 else 0.0
            newest = replace(newest, health=Health.LOST, std=math.inf, bridged=bridged)
        memory, _ = safeguarded.step(memory, tick, newest, signals(tick, speed=SPEED))
    assert all(one is None for one in seen[: 1900 // PERIOD])
    assert seen[-1] is not None


def test_the_laws_moves_after_a_handover_are_followed_in_full() -> None:
    """Held back to the slow rate they would lag a quarter of a period, and a closed loop would swing on that."""
    calm, moving = (
        drive(within(3000, 8000, FAULTS["lost"]), 14000, law=law, articulation=0.3).commands
        for law in (to_the_path, trembling)
    )
    ticks = np.arange(9000, 10800, PERIOD)  # the law steers, and the slow rate is that of both
    moves = (moving - calm)[ticks // PERIOD, 0]
    np.testing.assert_allclose(np.diff(moves), np.diff(0.05 * np.sin(2e-3 * ticks)), atol=1e-9)


@pytest.mark.parametrize(
    "change", [{"fallback": "straight"}, {"fallback": "dead_reckoning"}, {"hold": 0.2}, {"fade_rate": 0.5}]
)
def test_a_users_setting_takes_effect(change: dict[str, Any]) -> None:
    plain = drive(LOST_FOR_GOOD, 7000, articulation=0.3).commands
    changed = drive(LOST_FOR_GOOD, 7000, COMMAND_STEER.model_copy(update=change), articulation=0.3).commands
    assert np.abs(plain - changed).max() > 0.01


@pytest.mark.parametrize("fallback", ["command_steer", "dead_reckoning"])
def test_sensors_that_fail_too_leave_straight_wheels(fallback: FallbackName) -> None:
    commands = drive(LOST_FOR_GOOD, 12000, Degradation(fallback=fallback), articulation=math.nan).commands
    assert np.isfinite(commands).all()
    assert not commands[-1].any()


@pytest.mark.slow
@settings(max_examples=25)
@given(
    st.lists(
        st.sampled_from([*FAULTS.values(), lambda seen: seen, lambda seen: replace(seen, value=-5.0)]), max_size=35
    ),
    st.floats(-1.2, 1.2),
)
def test_no_sequence_of_faults_exceeds_the_actuators_limits(faults: list[Faulty], articulation: float) -> None:

    def fault(seen: OffTracking) -> OffTracking | None:
        k = seen.tick // CAMERA
        return faults[k](seen) if k < len(faults) else seen

    commands = drive(fault, 4500, articulation=articulation).commands
    assert np.isfinite(commands).all()
    assert np.abs(commands).max() <= TRAILER.max_steer + 1e-12
    assert np.abs(np.diff(commands, axis=0)).max() <= RATE * 0.02 + 1e-12


# Reversing


def stepped(speeds: list[float]) -> tuple[int, FloatArray]:
    """Steps that the law has counted, and the angles at every step of 20 ms, (n, 2)."""
    law, commands = Safeguarded(Law(lambda tick, good: math.radians(10.0)), "mine", TRAILER, COMBINATION), []
    memory, angles = law.init(), np.full(2, math.radians(10.0))
    for k, speed in enumerate(speeds):
        memory, command = law.step(memory, 20 * k, estimate(20 * k), signals(20 * k, speed=speed, angles=angles))
        angles = settle(angles, command.angles, 0.02, lag=TRAILER.actuator_lag, max_rate=RATE)
        commands.append(command.angles)
    return len(memory.law.ticks), np.array(commands)


def test_forwards_and_at_a_standstill_the_law_steers() -> None:
    steps, angles = stepped([2.0] * 5 + [0.0, 0.02, -0.02, -0.1] * 5)
    assert steps == 25
    np.testing.assert_array_equal(angles, math.radians(10.0))


def test_in_reverse_the_wheels_straighten_at_the_actuators_rate_and_the_law_starts_anew_afterwards() -> None:
    """While it stands after reversing it is still locked."""
    steps, angles = stepped([1.0] * 10 + [-1.0] * 50 + [0.0] * 10 + [1.0] * 4)
    changes = -np.diff(angles[:60, 0])
    assert changes.max() == pytest.approx(0.02 * RATE)
    assert changes.min() >= 0.0
    np.testing.assert_allclose(angles[59:70], 0.0, atol=1e-12)
    assert steps == 4
    np.testing.assert_array_equal(angles[-1], math.radians(10.0))


# Failed actuators

SLOPE = math.radians(3.0)  # rate of the law's angles [rad/s]
OFFSET = math.radians(8.0)


def wanted(tick: int) -> float:
    return SLOPE * min(tick * 1e-3, 3.0)


def supervised(until: int, actuators: Actuators) -> Drive:
    """A standing drive without estimates whose law turns both axles left, slowly, up to 9 deg."""
    return drive(
        lambda seen: None,
        until,
        Degradation(),
        speed=lambda tick: 0.0,
        law=lambda tick, good: wanted(tick),
        actuators=actuators,
    )


def test_sound_actuators_get_the_laws_demands_to_the_bit() -> None:
    run = supervised(4000, lambda tick, demand, angles: demand)
    assert run.commands.tolist() == [[wanted(tick)] * 2 for tick in range(0, 4000, PERIOD)]
    assert run.known is not None
    assert run.known.able.all()
    assert run.known.goal.tolist() == run.commands[-2].tolist()
    assert not run.last.actuator_findings


@pytest.mark.parametrize(("end", "left", "kind"), [(9999, OFFSET, "offset"), (4000, 0.0, "sound")])
def test_an_offset_is_subtracted_from_the_demand_as_long_as_it_lasts(end: int, left: float, kind: str) -> None:
    """Axles that stand 8 deg beside their demand come back to the angle that the law wants, within 0.1 deg."""
    run = supervised(6000, lambda tick, demand, angles: demand + OFFSET * (1000 <= tick < end))
    assert run.known is not None
    assert run.angles[-1] == pytest.approx([wanted(6000)] * 2, abs=math.radians(0.1))
    assert run.commands[-1] == pytest.approx([wanted(6000) - left] * 2, rel=0.0, abs=math.radians(0.1) if left else 0.0)
    assert run.known.goal == pytest.approx([wanted(6000)] * 2, abs=math.radians(0.1))
    assert run.last.actuator_findings[-1].kind == kind


def test_the_other_axle_takes_over_a_part_of_what_a_stuck_one_lacks() -> None:
    """It steers further than the law wants, and never so far that the steer moment is more than the law's."""
    run = supervised(4000, lambda tick, demand, angles: np.array([0.0, demand[1]]))
    axles, law = AxleGroup.of(TRAILER), np.full(2, wanted(4000))
    assert run.commands[-1, 1] > wanted(4000) + math.radians(1.0)
    assert axles.steer_moment(run.angles[-1]) < axles.steer_moment(law)
    assert run.known is not None
    assert run.known.able.tolist() == [False, True]
    assert run.known.goal[0] == run.angles[-1, 0]


def test_an_axle_that_answers_again_is_steered_at_once() -> None:
    """While it is stuck it gets the demand of the other one, at which it is soon seen to be sound."""
    run = supervised(6000, lambda tick, demand, angles: np.where([tick < 4500, False], angles, demand))
    assert run.known is not None
    assert run.known.able.all()
    assert run.angles[-1] == pytest.approx([wanted(6000)] * 2, abs=math.radians(0.1))
    assert np.abs(np.diff(run.commands, axis=0)).max() <= RATE * PERIOD * 1e-3 + 1e-12


def test_a_law_without_any_axle_that_answers_keeps_its_demands() -> None:
    """Nothing can be taken over; what the law wants is sent, so that the axles go on when they answer."""
    run = supervised(4000, lambda tick, demand, angles: np.zeros(2))
    assert run.commands[-1].tolist() == [wanted(4000)] * 2
    assert run.known is not None
    assert not run.known.able.any()


# Wrong output


class Stub(NamedTuple):
    """A law that returns a given command, or raises it; ``times`` it is closed."""

    command: object
    closed: list[bool]

    def init(self) -> int:
        return 0

    def step(
        self, memory: int, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[int, SteerCommand]:
        if isinstance(self.command, Exception):
            raise self.command
        return memory + 1, self.command  # type: ignore[return-value]  # as a user's law may

    def close(self) -> None:
        self.closed.append(True)


def angles(*values: float) -> SteerCommand:
    return SteerCommand(angles=np.array(values))


@pytest.mark.parametrize("checks_only", [False, True])
@pytest.mark.parametrize(
    ("command", "message"),
    [
        (angles(0.1, 0.2, 0.3), r"returned 3 angles, the trailer has 2 steered axles"),
        (SteerCommand(angles=np.zeros((2, 1))), r"returned angles of shape \(2, 1\), the trailer has 2 steered axles"),
        (angles(0.1, math.nan), r"returned the angles \[0\.1, nan\] rad"),
        (angles(math.inf, 0.0), r"returned the angles \[inf, 0\.0\] rad"),
        (SteerCommand(angles=[0.1, 0.2]), r"returned the angles \[0\.1, 0\.2\], not an array of numbers"),  # type: ignore[arg-type]
        (SteerCommand(angles=np.array(["a", "b"])), r"not an array of numbers"),
        (np.zeros(2), r"returned \(1, array\(\[0\., 0\.\]\)\), not \(memory, SteerCommand\)"),
        (ZeroDivisionError("float division by zero"), r"raised ZeroDivisionError: float division by zero"),
        (ValueError("two\nlines"), r"raised ValueError: two lines"),
    ],
)
def test_a_law_that_misbehaves_is_named_with_tick_and_value(command: object, message: str, checks_only: bool) -> None:
    name = "trailer_steering = mymod:Mine"
    law = Safeguarded(Stub(command, []), name, TRAILER, COMBINATION, checks_only=checks_only)
    with pytest.raises(LawError, match=rf"^trailer_steering = mymod:Mine: at tick 1200 \(1\.2 s\) it .*{message}"):
        law.step(law.init(), 1200, None, signals(1200, speed=2.0))


def test_a_good_command_passes_unchanged_and_the_law_is_closed() -> None:
    stub, unsteered = Stub(angles(0.1, -0.2), []), replace(TRAILER, steered=(False,) * 3)
    law = Safeguarded(stub, "mine", TRAILER, COMBINATION, checks_only=True)
    memory, command = law.step(law.init(), 1200, None, signals(1200))
    assert (memory.law, command.angles.tolist()) == (1, [0.1, -0.2])
    law.close()
    assert stub.closed == [True]
    none = Safeguarded(Stub(angles(), []), "none", unsteered, COMBINATION, Degradation())
    assert none.step(none.init(), 1200, None, signals(1200, angles=np.empty(0)))[1].angles.shape == (0,)


# Fallback


STUCK_AT = 4000  # [ticks]


def in_turn(tick: int, articulation: float | None = None) -> CombinationSignals:
    """A turn that begins after 2 s and grows smoothly; the articulation changes by the difference of the yaw rates."""
    since = max(0.0, tick * TICK - 2.0)
    gamma = 0.07 * (1.0 - math.cos(0.6 * since)) if articulation is None else articulation
    rates = [0.07 * 0.6 * math.sin(0.6 * since), 0.0]
    e = np.random.default_rng(tick).standard_normal(4) * [0.02, *np.radians([0.1, 0.1, 0.1])]  # noise shows what works
    return signals(tick, speed=2.8 + e[0], steer=e[1], articulation=np.array([gamma]), yaw_rates=rates + e[2:])


def fallen_back(stuck: bool) -> FloatArray:
    """Angles (n, 2) of dead reckoning for 7 s, five of them in a turn, behind the monitor of the signals."""
    monitor = SignalMonitor(COMBINATION.vehicle, COMBINATION.unit)
    fallback = Fallback(TRAILER, combination=COMBINATION, name="dead_reckoning")
    seen, memory, angles = monitor.init(), fallback.init(), [np.zeros(2)]
    for tick in range(0, 7000, 20):
        read = in_turn(tick, 0.045 if stuck and tick >= STUCK_AT else None)
        seen = monitor.received(seen, read)
        read = monitor.corrected(seen, read)
        memory = fallback.observed(memory, tick, None, read)
        memory, steered = fallback.steered(memory, tick, read, angles[-1])
        angles.append(steered)
    return np.array(angles)


def test_an_angle_that_is_stuck_is_corrected_before_it_is_reckoned_with() -> None:
    """An articulation that stays while two gyros differ by 3 deg/s."""
    sound, stuck = fallen_back(False), fallen_back(True)
    np.testing.assert_allclose(stuck, sound, atol=0.1)  # [rad]; 0.07 before it is found, 0.17 if it were not


def test_dead_reckoning_learns_nothing_at_a_creep() -> None:
    """Errors of the signals show in motion; at 0.1 m/s it goes on with what is known."""
    fallback, last = Fallback(TRAILER, combination=COMBINATION, name="dead_reckoning"), np.zeros(2)
    memory = fallback.init()
    for tick in range(0, 1000, 20):
        read, seen = signals(tick, speed=0.1), estimate(tick, v_x=0.1) if tick % CAMERA == 0 else None
        memory = fallback.observed(memory, tick, seen, read)
        memory, last = fallback.steered(memory, tick, read, last)
    assert last == pytest.approx([0.0, 0.0], abs=0.01)
