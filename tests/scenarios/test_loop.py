"""The loop as a whole: its timetable, its determinism, its symmetry."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from controllers.trailer import SteerCommand
from estimators.estimates import OffTracking
from scenarios.assembly import assemble
from scenarios.loop import Session
from scenarios.results import RunResult, summary
from scenarios.run import run
from scenarios.scenario import Scenario, load_scenario
from sensors.messages import SteerAngles

SHORT = ("off_tracking=truth", "course.turn_deg=60", "course.exit=5")
SEEN = ("course.length=20", "rig.width=480", "rig.height=200", "world.scenery_density=0.3")


class Witness:
    """A controller that steers nothing and notes how old its news is."""

    def init(self) -> tuple[float, ...]:
        return ()

    def step(
        self, memory: tuple[float, ...], tick: int, off_tracking: OffTracking | None, steer: SteerAngles
    ) -> tuple[tuple[float, ...], SteerCommand]:
        ages = memory if off_tracking is None else (*memory, off_tracking.age(tick))
        return ages, SteerCommand(angles=np.zeros(len(steer.angles)))


def short(*settings: str, seed: int = 1) -> RunResult:
    return run(load_scenario("roundabout", (*SHORT, *settings)), seed)


@pytest.mark.parametrize(("rate_hz", "latency"), [(10.0, 0.1), (5.0, 0.2), (10.0, 0.05)])
def test_news_is_as_old_as_the_latency_says(rate_hz: float, latency: float) -> None:
    """Zero-order hold: an estimate is used from its delivery until the next one's, one camera period later."""
    scenario = load_scenario("roundabout", (*SHORT, f"rig.rate_hz={rate_hz}", f"rig.latency={latency}"))
    session = Session(replace(assemble(scenario, seed=1), trailer_steering=Witness()))
    while session.outcome is None:
        session.advance()
    session.close()
    ages: Any = session._steering
    late = 0.01 if latency == 0.05 else 0.0  # delivered between two steps of the controller, which come every 20 ms
    assert min(ages) == pytest.approx(latency + late)
    assert max(ages) == pytest.approx(latency + late + 1.0 / rate_hz - 0.02)


def test_captures_follow_the_cameras_schedule() -> None:
    """Estimates carry the tick of their capture: 100 ms apart at 10 Hz."""
    log = short().log
    ticks = log["tick"][np.isfinite(log["health"])]
    np.testing.assert_array_equal(np.diff(ticks), 100.0)


def test_the_same_seed_gives_bitwise_the_same_log_and_images() -> None:
    """Determinism is what makes a run a piece of evidence; another seed must show another world."""
    scenario = load_scenario("constant-slip", SEEN)
    first, again, other = run(scenario, 1), run(scenario, 1), run(scenario, 2)
    assert first.log == again.log
    assert first.manifest["frames_sha256"] == again.manifest["frames_sha256"]
    assert first.manifest["frames_sha256"] != other.manifest["frames_sha256"]


def test_left_and_right_roundabout_are_mirror_images() -> None:
    """With exact estimates nothing knows left from right; rounding grows a little over thousands of slipping steps."""
    left, right = short().log, short("course.direction=right").log
    assert len(left) == len(right)
    for name in ("off_tracking_true", "steer_trailer_1", "y_semitrailer", "yaw_rate_tractor"):
        np.testing.assert_allclose(left[name], -right[name], atol=1e-6)


def test_with_cameras_left_and_right_agree_to_the_odometrys_noise() -> None:
    """The worlds differ, the vehicle does not: what the camera adds to the mirror image is a few millimetres of drift.

    15 mm and 1 degree are three times the noise of the estimate, and what it does to the steering; cut-in would be
    0.4 m.
    """
    settings = ("course.turn_deg=60", "course.exit=5", "rig.width=896", "rig.height=300")
    left = run(load_scenario("roundabout", settings), 1).log
    right = run(load_scenario("roundabout-right", settings), 1).log
    assert len(left) == pytest.approx(len(right), abs=2)
    n = min(len(left), len(right))
    e = left["off_tracking_true"][:n] + right["off_tracking_true"][:n]
    steer = left["steer_trailer_1"][:n] + right["steer_trailer_1"][:n]
    assert np.nanmax(np.abs(left["off_tracking_estimate"][:n] - left["off_tracking_true"][:n])) > 0.0
    assert np.sqrt(np.nanmean(e**2)) < 0.015
    assert np.sqrt(np.mean(steer**2)) < np.radians(1.0)


def test_constant_slip_has_its_closed_form_off_tracking() -> None:
    """14 m times tan 14 degrees: 3.4906 m (de Saxe & Cebon 2018, section 3.1); slip to the left puts the path right."""
    result = run(load_scenario("constant-slip", ("off_tracking=truth", "course.length=40")), 1)
    true = result.log["off_tracking_true"]
    np.testing.assert_allclose(true[np.isfinite(true)], -14.0 * np.tan(np.radians(14.0)), atol=1e-9)


def test_path_following_takes_away_the_cut_in() -> None:
    """Unsteered, the long trailer's rear cuts in by metres; following the hitch's path, by centimetres."""
    followed = summary(short("course.turn_deg=180"))["off_tracking"]
    unsteered = summary(short("course.turn_deg=180", "trailer_steering=none"))["off_tracking"]
    assert isinstance(followed, dict)
    assert isinstance(unsteered, dict)
    assert unsteered["true_max_m"] > 1.0
    assert followed["true_max_m"] < 0.12


@pytest.mark.parametrize(
    "setting",
    [
        "speed_kmh=8",
        "surface.friction=0.4",
        "surface.cross_fall=0.03",
        "surface.grade=0.02",
        "trailer_steering=none",
        "steering.gain=0.2",
        "rig.latency=0.2",
        "course.radius=14",
        "trailer_steering=none vehicle=eu_tractor_semitrailer",
    ],
)
def test_every_setting_has_an_effect(setting: str, plain: RunResult) -> None:
    """An option that is silently ignored makes a user believe in a run that never was."""
    assert short(*setting.split()).log != plain.log


@pytest.fixture(scope="module")
def plain() -> RunResult:
    return short()


def test_a_vehicle_that_leaves_the_course_times_out() -> None:
    """A truck that can not climb is an outcome, not an endless run: 20 % grade at friction 0.05."""
    scenario: Scenario = load_scenario("roundabout", (*SHORT, "surface.friction=0.05", "surface.grade=0.2"))
    assert run(scenario, 1).outcome in ("timed out", "diverged")
