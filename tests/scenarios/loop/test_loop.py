"""The loop as a whole: its timetable, its determinism, its symmetry."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from controllers.driver import DriverCommand
from controllers.trailer import Combination, SteerCommand
from controllers.trailer_steering.safeguarded import Safeguarded
from estimators.estimates import OffTracking
from scenarios.assembly.drivers_and_laws import OpenedDriver
from scenarios.assembly.trailer_run import assemble
from scenarios.image_file import PictureSize
from scenarios.loop.channel import Pacer
from scenarios.loop.runner import run
from scenarios.loop.trailer_session import TrailerSession
from scenarios.options.scenario import load_scenario
from scenarios.progress import Progress
from scenarios.results.trailer_result import RunResult
from sensors.messages import CombinationSignals, EgoState
from vehicle.clock import TICK

pytestmark = pytest.mark.usefixtures("worlds")
EXACT = ("off_tracking=truth", "reference_unit=false")
SHORT = (*EXACT, "course.entry=20", "course.turn_deg=30", "course.exit=5")
QUICK = "speed_kmh=20"  # half as many steps
SEEN = ("course.length=20", "rig.width=480", "rig.height=200", "world.scenery_density=0.3")


class Witness:
    """A controller that steers nothing and notes the age of its estimates."""

    def __init__(self) -> None:
        self.ages: list[float] = []

    def init(self) -> None:
        return None

    def step(
        self, memory: None, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[None, SteerCommand]:
        if off_tracking is not None:
            self.ages.append(off_tracking.age(tick))
        return None, SteerCommand(angles=np.zeros(len(signals.angles)))


def interrupted_after(calls: int) -> Progress:
    left = iter(range(calls - 1))

    def report(done: float, total: float, note: str = "", /) -> None:
        if next(left, None) is None:
            raise KeyboardInterrupt

    return report


def short(*settings: str, seed: int = 1) -> RunResult:
    return run(load_scenario("roundabout", (*SHORT, *settings)), seed)


@pytest.mark.parametrize(("rate_hz", "latency"), [(10.0, 0.1), (5.0, 0.2), (10.0, 0.05)])
def test_news_is_as_old_as_the_latency_says(rate_hz: float, latency: float) -> None:
    """Zero-order hold: an estimate is used from its delivery until the next one's, one camera period later."""
    scenario = load_scenario("roundabout", (*SHORT, f"rig.rate_hz={rate_hz}", f"rig.latency={latency}"))
    parts = assemble(scenario, seed=1)
    witness = Witness()
    trailer = parts.trailers[-1]
    combination = Combination(parts.vehicle, trailer.unit)
    law = Safeguarded(witness, "witness", trailer.geometry, combination, checks_only=True)
    session = TrailerSession(replace(parts, trailers=(replace(trailer, law=law),)))
    while session.outcome is None:
        session.advance()
    session.close()
    ages = witness.ages
    late = 0.01 if latency == 0.05 else 0.0  # delivered between two steps of the controller, which come every 20 ms
    assert min(ages) == pytest.approx(latency + late)
    assert max(ages) == pytest.approx(latency + late + 1.0 / rate_hz - 0.02)


@pytest.fixture(scope="module")
def seen(worlds: Any) -> RunResult:
    """A second of a run with cameras; ten frames are taken."""
    return run(load_scenario("constant-slip", SEEN), 1, keep_frames=True, progress=interrupted_after(100))


@pytest.mark.slow
def test_the_same_seed_gives_bitwise_the_same_log_and_images(
    worlds: Any, seen: RunResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Determinism is what makes a run evidence; another seed must show another world.

    The world is made anew. Pictures for the page alone are smaller, and so are the strokes on them.
    """
    scenario = load_scenario("constant-slip", SEEN)
    worlds.forget()
    monkeypatch.setenv("OFFTRACK_CACHE", str(tmp_path / "cache"))
    again = run(scenario, 1, keep_frames=PictureSize(160, 50), progress=interrupted_after(100))
    shown, small = (
        cv2.imdecode(np.frombuffer(frame.jpeg, np.uint8), cv2.IMREAD_COLOR)
        for frame in (seen.frames[5], again.frames[5])
    )
    assert small is not None
    assert shown is not None
    assert small.shape == (round(160 * shown.shape[0] / shown.shape[1]), 160, 3)
    expected = (seen.frames[5].tracks + 0.5) * 160 / shown.shape[1]
    assert again.frames[5].tracks + 0.5 == pytest.approx(expected, rel=1e-4)
    other = run(scenario, 2, progress=interrupted_after(20))
    assert len(seen.log) == 100
    assert seen.log == again.log
    assert seen.manifest["frames_sha256"] == again.manifest["frames_sha256"]
    assert seen.manifest["frames_sha256"] != other.manifest["frames_sha256"]


def test_a_paced_run_has_bitwise_the_log_and_images_of_any_other(seen: RunResult) -> None:
    """Cameras are rendered in a thread while the loop goes on, and their estimates arrive after the same latency."""
    scenario = load_scenario("constant-slip", SEEN)
    kept = run(scenario, 1, pacer=Pacer(8.0), progress=interrupted_after(5))  # it is told every 0.2 s
    assert len(kept.log) == len(seen.log) == 100
    assert kept.log == seen.log
    assert kept.manifest["frames_sha256"] == seen.manifest["frames_sha256"]
    assert "paced" in kept.summary()
    assert "paced" not in seen.summary()
    assert len(seen.frames) == 10
    assert len(kept.frames) == 0  # they are kept on demand only


def test_matches_and_motions_are_in_the_log_and_with_the_pictures(seen: RunResult) -> None:
    """5 m/s at 10 Hz are half a metre a frame."""
    way = np.hypot(seen.log["odometry_dx"], seen.log["odometry_dy"])
    assert np.nanmedian(way) == pytest.approx(0.5, abs=0.02)
    shown = seen.frames[5]
    assert shown.matches >= shown.inliers > 20
    assert len(shown.tracks) > 20


@pytest.mark.slow
def test_left_and_right_roundabout_are_mirror_images() -> None:
    """With exact estimates nothing knows left from right; rounding grows a little over thousands of slipping steps."""
    left, right = short().log, short("course.direction=right").log
    assert len(left) == len(right)
    for name in ("off_tracking_true", "steer_trailer_1", "y_semitrailer", "yaw_rate_tractor"):
        np.testing.assert_allclose(left[name], -right[name], atol=1e-6)


@pytest.mark.slow
def test_a_lane_change_seen_by_cameras_keeps_the_trailer_on_its_path() -> None:
    """At 25 km/h path preview and virtual driver share the axles; all signals are sound: they need no fallback.

    The unsteered trailer leaves its path by 0.396 m, this one by 0.12 to 0.14 m (seeds 1, 2, 3, 101); the bar is half
    of the unsteered one's.
    """
    quick = ("rig.width=480", "rig.height=200", "world.scenery_density=0.3", "reference_unit=false")
    course = ("speed_kmh=25", "course.entry=20", "course.exit=20", "trailer_steering=path_preview")
    result = run(load_scenario("lane-change", (*quick, *course)), 1)
    assert result.outcome == "completed"
    assert [line for line in result.warnings if "virtual_driver steered there" not in line] == []
    assert np.nanmax(np.abs(result.log["off_tracking_true"])) < 0.198
    assert np.degrees(np.abs(result.log["steer_trailer_1"]).max()) > 3.0  # it steers


def test_constant_slip_has_its_closed_form_off_tracking() -> None:
    """14 m times tan 14 degrees: 3.4906 m (de Saxe & Cebon 2018, section 3.1); slip to the left puts the path right."""
    result = run(load_scenario("constant-slip", (*EXACT, "course.length=20")), 1)
    true = result.log["off_tracking_true"]
    np.testing.assert_allclose(true[np.isfinite(true)], -14.0 * np.tan(np.radians(14.0)), atol=1e-9)
    assert not result.log["acceleration_command"].any()  # nobody drives


def test_exact_poses_have_the_true_off_tracking_on_rough_banked_ground() -> None:
    """Rolling and pitching of the body over class E is no part of the definition; the rest is interpolation."""
    result = short("surface.roughness=E", "surface.cross_fall=-0.025", "surface.grade=0.1")
    error = result.log["off_tracking_estimate"] - result.log["off_tracking_true"]
    assert np.isfinite(error).sum() > 30
    assert np.nanmax(np.abs(error)) < 2e-4
    assert np.ptp(result.log["roll_semitrailer"]) > math.radians(1.0)
    assert result.log["pitch_semitrailer"].mean() == pytest.approx(-0.1, abs=0.01)  # uphill the nose is up


@pytest.mark.slow
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
    assert short(QUICK, *setting.split()).log != plain.log


@pytest.fixture(scope="module")
def plain() -> RunResult:
    return short(QUICK)


class Anchored:
    def init(self) -> None:
        """Nothing to remember."""

    def step(self, memory: None, tick: int, ego: EgoState) -> tuple[None, DriverCommand]:
        return None, DriverCommand(steer=0.0, acceleration=-1.0)


def test_a_vehicle_that_gets_stuck_times_out() -> None:
    """That is an outcome, not an endless run: half as much time again as the course takes, and 10 s."""
    parts = assemble(load_scenario("roundabout", (*SHORT, QUICK)), seed=1)
    stuck = OpenedDriver(driver=Anchored(), duration=parts.duration, start_speed=parts.start_speed)
    session = TrailerSession(replace(parts, driver=stuck))
    while session.outcome is None:
        session.advance()
    session.close()
    assert session.outcome == "timed out"
    assert session.tick * TICK == pytest.approx(10.0 + 1.5 * parts.course.length / parts.scenario.speed, abs=0.02)


@pytest.mark.parametrize(
    ("outcome", "settings"),
    [
        ("jackknifed", ["vehicle=wb67"]),  # its trailer can not follow round a 12.5 m circle
        ("rolled over", ["vehicle=eu_tractor_semitrailer", "speed_kmh=45", "course.radius=20", "surface.friction=1.2"]),
        ("left the road", ["vehicle=eu_tractor_semitrailer", "speed_kmh=35", "surface.friction=0.2"]),
        ("left the road", ["surface.friction=0.05", "surface.grade=0.2"]),  # it slides down backwards
    ],
)
def test_what_befalls_a_combination_is_the_outcome_of_its_run(outcome: str, settings: list[str]) -> None:
    """Centripetal acceleration is 0.8 g in the roll-over, tips at 0.5 g, and 0.2 g of friction hold 0.8 g nowhere."""
    scenario = load_scenario("roundabout", (*EXACT, "trailer_steering=none", *settings))
    result = run(scenario, 1)
    assert result.summary()["outcome"] == outcome
