"""Runs that keep wall time: the clock decides when a step is computed, never what comes out."""

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
    def __init__(self) -> None:
        self.now = 100.0  # [s]

    def __call__(self) -> float:
        return self.now

    def work(self, seconds: float) -> None:
        self.now += seconds


def paced(speed: float, *steps: float, waited: float = 0.0) -> Pacer:
    """A pacer after steps of 10 ticks that took these times, the last one with a wait for the cameras [s]."""
    clock = Clock()
    pacer = Pacer(speed, clock=clock, sleep=clock.work)
    for k, seconds in enumerate(steps):
        pacer.begin(10 * k, 0.0)
        clock.work(seconds)
        pacer.end(10 * k + 10, waited if k == len(steps) - 1 else 0.0)
    return pacer


def test_late_steps_are_reported_and_made_up_for_by_quick_ones() -> None:
    """A step has 10 ms of wall time at speed 1, 20 ms at half speed.

    25 ms instead of 10: 15 ms late; steps of 2 ms then end 7 ms late, and 1 ms early. Steps of 20 ms fill wall time at
    half of real time; a fifth of reserve is left.
    """
    assert paced(1.0, 0.009, 0.002, 0.009).report().misses == 0
    report = paced(0.5, 0.019, 0.019).report()
    assert (report.misses, report.step_s) == pytest.approx((0, 0.02))
    report = paced(1.0, 0.025, 0.002, 0.002, 0.002).report()
    assert (report.misses, report.behind_s) == (2, 0.0)
    assert (report.worst_s, report.longest_step_s) == pytest.approx((0.015, 0.025))
    report = paced(1.0, *[0.02] * 10).report()
    assert report.best_speed == pytest.approx(0.5)
    assert "100.0 % of the steps ended after their 10 ms, by 100 ms at worst" in report.warnings[0]
    assert report.warnings[0].endswith("mostly the loop; try --speed 0.4")
    assert "mostly waiting for cameras and odometry" in paced(1.0, *[0.02] * 10, waited=0.015).report().warnings[0]


@dataclass(frozen=True)
class Reading:
    tick: int


class Camera:
    def sample(self, truth: Reading) -> Reading | None:
        return truth


class Nothing:
    def init(self) -> None:
        return None

    def step(self, memory: None, message: Reading) -> tuple[None, Reading]:
        return None, message


@pytest.mark.parametrize(("fails", "line"), [("camera", "the lens fell off"), ("recording", "no space left")])
def test_what_fails_in_the_camera_thread_is_named_at_the_delivery(fails: str, line: str) -> None:
    """The loop learns of it when it would receive the estimate, not in silence at the end."""

    def failing(*_: object) -> Any:
        raise OSError(line)

    camera, see = Camera(), None if fails == "camera" else failing
    if fails == "camera":
        camera.sample = failing  # type: ignore[assignment, method-assign]
    with ThreadPoolExecutor(1) as renderer, ThreadPoolExecutor(1) as worker:
        schedule = Schedule(period=10, latency=20)
        channel = Channel(camera, schedule, Nothing(), worker, Stopwatch(), renderer=renderer, see=see)
        assert channel.sample(Reading(30), 30) is None
        renderer.submit(lambda: None).result()
        with pytest.raises(LawError, match=rf"sensor Camera: at tick 30 .*raised OSError: {line}"):
            channel.deliver(50)


class Order(ThreadPoolExecutor):
    def __init__(self) -> None:
        super().__init__(1)
        self.given: list[str] = []

    def submit(self, call: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
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
