"""Degradation: what steers a trailer when its off-tracking estimate can not be relied on."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.trailer import SteerCommand
from controllers.trailer_steering.fallback import FallbackName
from controllers.trailer_steering.guard import Degradation, Guarded, GuardMemory, signal_findings
from controllers.trailer_steering.signal_laws import CommandSteer
from estimators.estimates import Health, OffTracking
from sensors.messages import CombinationSignals
from tests.trailers import COMBINATION, signals
from tests.trailers import TWO_OF_THREE as TRAILER
from vehicle.frames import FloatArray

SPEED = 2.8  # [m/s]
PERIOD, CAMERA = 20, 100  # of steps and estimates [ticks]
WANTED = 0.2  # what the law under guard steers by any estimate that it is given [rad]
COMMAND_STEER = Degradation(fallback="command_steer")  # the signals here are those of no real motion
PATH = np.column_stack([-np.linspace(0.0, 16.0, 60), np.zeros(60)])


class Believes:
    """A law that steers by whatever estimate it is given: WANTED times the sign of its value, straight without one."""

    def init(self) -> tuple[int, ...]:
        """Ticks of the estimates it has been given."""
        return ()

    def step(
        self, memory: tuple[int, ...], tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[tuple[int, ...], SteerCommand]:
        if off_tracking is None or off_tracking.health is Health.LOST:
            return memory, SteerCommand(angles=np.zeros(2))
        return (*memory, off_tracking.tick), SteerCommand(angles=np.full(2, math.copysign(WANTED, off_tracking.value)))


def estimate(tick: int, **changes: Any) -> OffTracking:
    """Straight travel, the path 0.1 m to the left."""
    seen = OffTracking(
        tick=tick,
        value=0.1,
        std=0.01,
        health=Health.OK,
        path=PATH,
        hitch_direction=0.0,
        hitch_direction_rate=0.0,
        path_tangent=0.0,
        v_x=SPEED,
        v_y=0.0,
        yaw_rate=0.0,
    )
    return replace(seen, **changes)


Faulty = Callable[[OffTracking], OffTracking | None]  # None: it does not arrive


def drive(
    faulty: Faulty,
    until: int,
    degradation: Degradation | None = None,
    *,
    articulation: float = 0.0,
    speed: float = SPEED,
    law: type[Believes] = Believes,
) -> tuple[FloatArray, FloatArray, GuardMemory]:
    """Ticks, commands (steps, axles) and the last memory, with an estimate of 0.1 s ago every 0.1 s."""
    guarded = Guarded(law(), TRAILER, COMBINATION, degradation or COMMAND_STEER)
    angle = articulation if math.isfinite(articulation) else 0.0
    motion = {"v_x": speed * math.cos(angle), "v_y": speed * math.sin(angle)}  # of the hitch behind a tractor on a line
    memory, newest, commands = guarded.init(), None, []
    ticks = np.arange(0, until, PERIOD)
    for tick in ticks.tolist():
        if tick % CAMERA == 0 and tick:
            newest = faulty(estimate(tick - CAMERA, **motion)) or newest
        memory, command = guarded.step(
            memory, tick, newest, signals(tick, articulation=np.array([articulation]), speed=speed)
        )
        commands.append(command.angles)
    return ticks.astype(np.float64), np.array(commands), memory


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
bad = pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS.keys())


def test_good_estimates_leave_the_law_alone() -> None:
    """Without faults the guard adds nothing but the actuators' limits."""
    ticks, commands, memory = drive(lambda seen: seen, 3000)
    assert memory.law[:3] == (0,) * 3
    assert (commands[ticks >= 800] == WANTED).all()  # 0.2 rad at 20 deg/s take 0.57 s from the first estimate on


@bad
def test_a_short_fault_is_bridged_by_the_last_good_estimate(fault: Faulty) -> None:
    """0.5 s are 1.4 m at this speed: the law goes on with what it has."""
    ticks, commands, memory = drive(within(3000, 3500, fault), 6000)
    assert (commands[ticks > 1000] == WANTED).all()
    assert not [tick for tick in set(memory.law) if 3000 <= tick < 3500]


@bad
def test_a_long_fault_ends_with_straight_wheels_at_a_slow_rate(fault: Faulty) -> None:
    """Straight ahead the fallback has nothing to steer; the rate begins at 0.05 rad/s and quickens by that a second."""
    ticks, commands, _ = drive(within(3000, 99999, fault), 9000)
    held = (ticks > 1000) & (ticks <= 4000)
    assert (commands[held] == WANTED).all()  # the last good one arrived at 3.0 s
    letting_go = ticks > 4000
    since = (ticks[letting_go] - 4000.0) * 1e-3
    rates = -np.diff(commands[:, 0])[letting_go[1:]] / 0.02
    assert (rates <= 0.05 * (1.0 + since) + 1e-9).all()
    assert (commands[ticks > 7000] == 0.0).all()  # 0.05 (t + t^2/2) = 0.2 after 2 s


@pytest.mark.parametrize("fault", [FAULTS[name] for name in FAULTS if name != "frozen"])  # that one: see below
def test_the_law_takes_over_again_without_a_jerk(fault: Faulty) -> None:
    """Half a second of good estimates, then from where the axles are at the slow rate; all is as before in the end."""
    ticks, commands, _ = drive(within(3000, 8000, fault), 14000)
    assert (commands[(ticks > 7000) & (ticks < 8500)] == 0.0).all()
    rates = np.diff(commands[:, 0])[ticks[1:] > 8000] / 0.02
    assert rates[rates > 0.0][0] == pytest.approx(0.05, rel=0.03)  # it quickens by a fiftieth in a step
    assert rates.min() >= 0.0
    assert rates.max() <= 0.05 * (1.0 + 2.0)  # it is there after 2 s: 0.05 (t + t^2/2) = 0.2
    assert (commands[-10:] == WANTED).all()


def test_a_freeze_leaves_a_gap_in_the_path_that_has_to_be_passed() -> None:
    """5.6 m in 2 s are missing, of which some is forgotten meanwhile; at 1.4 m the path is good again.

    d = 14 (1 - exp(-5.6/14)) = 4.6 m, and 14 ln(4.6/1.4) = 16.7 m of way until then.
    """
    ticks, commands, memory = drive(within(3000, 5000, FAULTS["frozen"]), 16000)
    missing = 14.0 * (1.0 - math.exp(-5.6 / 14.0))
    passed = 5000 + 1000.0 * 14.0 * math.log(missing / 1.4) / SPEED
    taken = [tick for tick in memory.law if tick >= 5000]
    assert taken[0] == pytest.approx(passed, abs=200.0)  # the law sees it half a second before it steers
    assert (commands[(ticks > 7000) & (ticks < passed)] == 0.0).all()
    assert (commands[-10:] == WANTED).all()


def test_a_wheel_speed_that_fails_does_not_cost_a_sound_estimate() -> None:
    """It falls to zero at once, which no vehicle does; estimates and yaw rates go on. It is named."""
    guarded = Guarded(Believes(), TRAILER, COMBINATION, Degradation())
    memory, newest = guarded.init(), None
    for tick in range(0, 8000, PERIOD):
        if tick % CAMERA == 0 and tick:
            newest = estimate(tick - CAMERA)
        memory, command = guarded.step(memory, tick, newest, signals(tick, speed=SPEED if tick < 3000 else 0.0))
        if tick > 1000:
            assert (command.angles == WANTED).all()
    assert memory.law[-1] == 7900 - CAMERA
    assert [finding.signal for finding in signal_findings(memory)] == ["wheel speed"]


def test_an_implausible_jump_is_passed_over() -> None:
    """One estimate a metre off, of the other sign, would throw the axles about."""
    jump = within(3000, 3100, lambda seen: replace(seen, value=-0.9))
    ticks, commands, memory = drive(jump, 6000)
    assert 3000 not in memory.law
    assert (commands[ticks > 1000] == WANTED).all()


def test_a_jump_that_stays_is_believed_after_a_while() -> None:
    """It is the old path that was wrong, then; the axles go over to the new one at the slow rate."""
    ticks, commands, memory = drive(within(3000, 99999, lambda seen: replace(seen, value=-0.9)), 10000)
    assert min(tick for tick in memory.law if tick >= 3000) == pytest.approx(3000 + 600, abs=100)
    assert np.abs(np.diff(commands[:, 0]))[ticks[1:] > 3000].max() / 0.02 <= 0.25
    assert (commands[-10:] == -WANTED).all()


def test_a_slow_change_is_no_jump() -> None:
    """A path that comes nearer as the trailer turns to it is what the motion says; 0.3 rad make 0.084 m a frame."""
    turned = estimate(0, path_tangent=0.3)
    nearing = within(
        0, 99999, lambda seen: replace(turned, tick=seen.tick, value=0.1 + 0.3093 * SPEED * seen.tick * 1e-3)
    )
    _, _, memory = drive(nearing, 5000, Degradation(max_jump=0.02))
    assert sorted(set(memory.law)) == list(range(0, 4800 + 1, CAMERA))


def test_in_a_turn_the_axles_go_over_to_command_steer() -> None:
    """With an articulation of 20 deg straight wheels cut in by metres; the sensors of the combination know."""
    _, commands, _ = drive(within(3000, 99999, FAULTS["lost"]), 12000, articulation=math.radians(20.0))
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
    ticks, commands, _ = drive(within(3000, 99999, FAULTS["lost"]), 9000, articulation=0.1, speed=25.0)
    assert (commands[(ticks > 1000) & (ticks <= 3300)] == WANTED).all()
    assert (commands[(ticks > 3340) & (ticks < 3500)] < WANTED).all()
    assert not commands[-1].any()


def test_a_first_estimate_that_does_not_come_is_not_waited_for() -> None:
    """The path is long enough after 14 m, 5 s; a hold and a gap later command steer has the axles."""
    ticks, commands, memory = drive(FAULTS["lost"], 12000, articulation=math.radians(20.0))
    assert not memory.steers
    assert not commands[ticks < 6300].any()
    assert np.abs(commands[-1]).max() > math.radians(5.0)
    assert np.abs(np.diff(commands[:, 0])).max() / 0.02 <= 0.05 * (1.0 + 4.0)  # it is there after 4 s


class Trembles(Believes):
    """The same law, asking for what goes to and fro at 6 deg/s."""

    def step(
        self, memory: tuple[int, ...], tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[tuple[int, ...], SteerCommand]:
        memory, command = super().step(memory, tick, off_tracking, signals)
        return memory, SteerCommand(angles=command.angles + 0.05 * math.sin(2e-3 * tick))


def test_what_the_law_does_after_a_change_of_hands_it_does_in_full() -> None:
    """Held back to the slow rate its moves would lag a quarter of a period, and a closed loop would swing on that."""
    calm, trembling = (
        drive(within(3000, 8000, FAULTS["lost"]), 14000, law=law, articulation=0.3)[1] for law in (Believes, Trembles)
    )
    ticks = np.arange(9000, 10800, PERIOD)  # the law steers, and the slow rate is that of both
    moves = (trembling - calm)[ticks // PERIOD, 0]
    np.testing.assert_allclose(np.diff(moves), np.diff(0.05 * np.sin(2e-3 * ticks)), atol=1e-9)


@pytest.mark.parametrize(
    "change", [{"fallback": "straight"}, {"fallback": "dead_reckoning"}, {"hold": 0.2}, {"fade_rate": 0.5}]
)
def test_what_the_user_sets_is_what_happens(change: dict[str, Any]) -> None:
    """Each of them changes the end of a long fault in a turn."""
    fault = within(3000, 99999, FAULTS["lost"])
    _, plain, _ = drive(fault, 7000, articulation=0.3)
    _, changed, _ = drive(fault, 7000, replace(COMMAND_STEER, **change), articulation=0.3)
    assert np.abs(plain - changed).max() > 0.01


@pytest.mark.parametrize("fallback", ["command_steer", "dead_reckoning"])
def test_sensors_that_fail_too_leave_straight_wheels(fallback: FallbackName) -> None:
    """Neither estimate nor articulation: there is nothing to steer by."""
    lost = within(3000, 99999, FAULTS["lost"])
    _, commands, _ = drive(lost, 12000, Degradation(fallback=fallback), articulation=math.nan)
    assert np.isfinite(commands).all()
    assert not commands[-1].any()


@settings(max_examples=25)
@given(
    st.lists(
        st.sampled_from([*FAULTS.values(), lambda seen: seen, lambda seen: replace(seen, value=-5.0)]), max_size=60
    ),
    st.floats(-1.2, 1.2),
)
def test_whatever_befalls_the_estimates_no_limit_is_exceeded(faults: list[Faulty], articulation: float) -> None:
    """Any sequence of faults, frame by frame, at any articulation: finite, and within angle and rate."""

    def fault(seen: OffTracking) -> OffTracking | None:
        k = seen.tick // CAMERA
        return faults[k](seen) if k < len(faults) else seen

    _, commands, _ = drive(fault, 7000, articulation=articulation)
    assert np.isfinite(commands).all()
    assert np.abs(commands).max() <= TRAILER.max_steer + 1e-12
    assert np.abs(np.diff(commands, axis=0)).max() <= TRAILER.max_steer_rate * 0.02 + 1e-12


@pytest.mark.parametrize(
    ("name", "value"), [("hold", 2.0), ("fade_rate", 0.0), ("max_age", math.nan), ("recovery", -1)]
)
def test_a_setting_outside_its_limits_is_refused(name: str, value: float) -> None:
    """By name, value and limits."""
    with pytest.raises(ValueError, match=rf"{name} = {value} .*must be between"):
        replace(Degradation(), **{name: value})  # type: ignore[arg-type]  # of any field, for mypy
