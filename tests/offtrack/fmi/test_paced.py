"""Runs that keep wall time: the clock decides when a step is computed, never what comes out."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import pytest

from controllers.checked import LawError
from scenarios.loop.channel import Channel, Pacer, Stopwatch
from scenarios.loop.runner import run
from scenarios.options.scenario import load_scenario
from vehicle.clock import Schedule


class Clock:
    """A clock that only moves when somebody sleeps or works."""

    def __init__(self) -> None:
        self.now = 100.0  # [s]

    def __call__(self) -> float:
        return self.now

    def work(self, seconds: float) -> None:
        self.now += seconds


def paced(speed: float, *steps: float) -> Pacer:
    """A pacer after steps of 10 ticks that took these times [s]."""
    clock = Clock()
    pacer = Pacer(speed, clock=clock, sleep=clock.work)
    for k, seconds in enumerate(steps):
        pacer.begin(10 * k, 0.0)
        clock.work(seconds)
        pacer.end(10 * k + 10, 0.0)
    return pacer


def test_steps_that_end_in_time_are_no_misses() -> None:
    """A step has 10 ms of wall time at speed 1, 20 ms at half speed."""
    assert paced(1.0, 0.009, 0.002, 0.009).report().misses == 0
    report = paced(0.5, 0.019, 0.019).report()
    assert report.misses == 0
    assert report.step_s == pytest.approx(0.02)


def test_a_late_step_is_made_up_for_by_quick_ones() -> None:
    """25 ms instead of 10: 15 ms late; steps of 2 ms then end 7 ms late, and 1 ms early. Then the clock rules again."""
    report = paced(1.0, 0.025, 0.002, 0.002, 0.002).report()
    assert report.misses == 2
    assert report.worst_s == pytest.approx(0.015)
    assert report.behind_s == 0.0
    assert report.longest_step_s == pytest.approx(0.025)


def test_a_run_that_cannot_keep_up_names_a_speed_that_it_could_keep() -> None:
    """Steps of 20 ms fill wall time at half of real time; a fifth of reserve is left."""
    report = paced(1.0, *[0.02] * 10).report()
    assert report.best_speed == pytest.approx(0.5)
    assert "100.0 % of the steps ended after their 10 ms, by 100 ms at worst" in report.warnings[0]
    assert report.warnings[0].endswith("try --speed 0.4")


@dataclass(frozen=True)
class Reading:
    tick: int


class BrokenCamera:
    def sample(self, truth: Reading) -> Reading | None:
        raise OSError("the lens fell off")


class Nothing:
    def init(self) -> None:
        return None

    def step(self, memory: None, message: Reading) -> tuple[None, Reading]:
        return None, message


def test_a_camera_that_fails_in_its_thread_is_named_at_the_delivery() -> None:
    """The loop learns of it when it would receive the estimate, not in silence at the end."""
    with ThreadPoolExecutor(1) as renderer, ThreadPoolExecutor(1) as worker:
        schedule = Schedule(period=10, latency=20)
        channel = Channel(BrokenCamera(), schedule, Nothing(), worker, Stopwatch(), renderer=renderer)
        assert channel.sample(Reading(30), 30) is None
        channel.deliver(40)
        with pytest.raises(LawError, match=r"sensor BrokenCamera: at tick 30 .*raised OSError: the lens fell off"):
            channel.deliver(50)


class Camera:
    def sample(self, truth: Reading) -> Reading | None:
        return truth


class Order(ThreadPoolExecutor):
    """A thread that notes what it is given."""

    def __init__(self) -> None:
        super().__init__(1)
        self.given: list[str] = []

    def submit(self, call: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Note the name of the call."""
        self.given.append(getattr(call, "__name__", ""))
        return super().submit(call, *args, **kwargs)


def jpeg() -> None:
    """A picture for the report."""


def test_pictures_wait_for_the_estimate_and_not_the_other_way_round() -> None:
    """Both are computed by one thread, and the estimate has a deadline."""
    with ThreadPoolExecutor(1) as renderer, Order() as worker:

        def see(*_: object) -> None:
            worker.submit(jpeg)

        schedule = Schedule(period=10, latency=20)
        channel = Channel(Camera(), schedule, Nothing(), worker, Stopwatch(), renderer=renderer, see=see)
        channel.sample(Reading(30), 30)
        channel.deliver(50)
    assert worker.given == ["_keep_promise", "jpeg"]
    assert list(channel.delivered) == [Reading(30)]


def test_a_picture_that_cannot_be_recorded_ends_the_run_by_name() -> None:
    def full(*_: object) -> None:
        raise OSError("no space left")

    with ThreadPoolExecutor(1) as renderer, ThreadPoolExecutor(1) as worker:
        schedule = Schedule(period=10, latency=20)
        channel = Channel(Camera(), schedule, Nothing(), worker, Stopwatch(), renderer=renderer, see=full)
        channel.sample(Reading(30), 30)
        renderer.submit(lambda: None).result()
        with pytest.raises(LawError, match=r"sensor Camera: at tick 30 .*raised OSError: no space left"):
            channel.deliver(40)


def test_the_progress_of_a_paced_run_is_shown_and_its_interrupt_ends_it() -> None:
    """Ctrl-C while the loop waits for the clock ends the run like any other; the results so far are kept."""
    seen = SimpleNamespace(count=0)

    def interrupted(*_: object) -> None:
        seen.count += 1
        raise KeyboardInterrupt

    scenario = load_scenario("roundabout", ("off_tracking=truth", "reference_unit=false"))
    result = run(scenario, 1, pacer=Pacer(20.0), progress=interrupted)
    assert (result.outcome, seen.count, len(result.log)) == ("interrupted", 1, 20)
    numbers = result.summary()["paced"]
    assert isinstance(numbers, dict)
    assert (numbers["speed"], numbers["steps"]) == (20.0, 20)
