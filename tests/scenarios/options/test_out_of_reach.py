"""Drives that the vehicle can not do, and vehicles far from where they should be, end in outcomes that say so."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from controllers.driver import PreviewDriver
from scenarios.assembly.rover_run import PERIOD, assemble_rover
from scenarios.assembly.trailer_run import assemble
from scenarios.loop.referee import CourseJudge
from scenarios.loop.rover_session import RoverJudge
from scenarios.loop.runner import run
from scenarios.options.scenario import RoverScenario, load_any_scenario, load_scenario
from vehicle.frames import Pose2

QUICK = ("off_tracking=truth", "trailer_steering=none", "reference_unit=false", "surface.roughness=none")


def outcome_of(rows: str, folder: Path, *settings: str) -> tuple[str, float]:
    """Outcome and duration [s] of a recorded drive, given without its heading's ``time_s,steer_deg,``."""
    file = folder / "drive.csv"
    file.write_text(f"time_s,steer_deg,{rows}\n", encoding="utf-8")
    scenario = load_any_scenario("cambered-road", (*QUICK, f"driver.trace={file}", *settings))
    result = run(scenario, 1)
    return result.outcome, float(result.log["time"][-1])


@pytest.mark.parametrize(
    ("rows", "settings", "outcome"),
    [
        ("speed_kmh\n0,0,10\n3,0,120\n30,0,120", (), "did not reach the recorded speed"),  # 10 m/s2 of a 40 t lorry
        ("speed_kmh\n0,0,60\n60,0,60", ("surface.grade=0.2",), "did not reach the recorded speed"),
        ("speed_kmh\n0,0,80\n3,0,0\n30,0,0", ("surface.friction=0.1",), "did not reach the recorded speed"),
        ("speed_kmh\n0,0,10\n2,80,10\n30,80,10", (), "did not reach the recorded steer angle"),
        ("acceleration\n0,0,15\n30,0,15", ("speed_kmh=20",), "did not reach the recorded acceleration"),
        (
            "speed_kmh\n0,0,10\n3,0,10\n4,0,150\n5,0,150",
            (),
            "did not reach the recorded speed",
        ),  # ends before it counts as late
    ],
)
def test_a_recorded_drive_beyond_the_vehicle_says_so(
    rows: str, settings: tuple[str, ...], outcome: str, tmp_path: Path
) -> None:
    """Some seconds after the vehicle has fallen behind; it used to be "completed"."""
    got, time = outcome_of(rows, tmp_path, *settings)
    assert got == outcome
    assert time < 25.0


@pytest.mark.parametrize(
    "rows",
    [
        "speed_kmh\n0,0,60\n4,0,64\n8,1,50\n10,-1,48",
        "speed_kmh\n0,0,20\n3,0,0\n8,0,0\n11,0,10\n13,0,12",  # a stop
        "acceleration\n0,0,-3\n6,0,-3",  # it stands after 5 s, and the brakes do no more
        "acceleration\n0,0,0.5\n6,0,-0.5\n10,0,0",
    ],
)
def test_a_recorded_drive_within_reach_is_completed(rows: str, tmp_path: Path) -> None:
    assert outcome_of(rows, tmp_path, "speed_kmh=50")[0] == "completed"


def rover_path(name: str, *settings: str) -> tuple[Any, Any]:
    """A rover's assembly, and a function that judges it at a sequence of positions."""
    scenario = load_any_scenario(name, ("slip_estimator=truth", *settings))
    assert isinstance(scenario, RoverScenario)
    parts = assemble_rover(scenario, 1)

    def judged(positions: np.ndarray[Any, Any]) -> str | None:
        judge = RoverJudge(parts)
        for k, (x, y) in enumerate(positions):
            truth: Any = SimpleNamespace(
                tick=k * PERIOD, pose=np.array([x, y, 0.0]), slip_ratios=np.zeros(4), sinkages=np.zeros(4)
            )
            if outcome := judge.outcome(truth):
                return outcome
        return None

    return parts, judged


ROVER_COURSES = [
    ("rover-slope", ()),
    ("rover-uphill", ()),
    ("rover-craters", ()),
    ("rover-figure-of-eight", ()),
    ("rover-figure-of-eight", ("course.radius=1",)),
    ("rover-figure-of-eight", ("course.kind=arc", "course.radius=1", "course.turn_deg=720")),
]


@pytest.mark.parametrize(("name", "settings"), ROVER_COURSES)
@pytest.mark.parametrize("direction", [0.6, 2.0, 3.1, -1.0, -2.5])
def test_a_rover_that_slides_away_from_the_start_has_left_its_path(
    name: str, settings: tuple[str, ...], direction: float
) -> None:
    """On any course and in any direction, also straight back, and whatever is near there."""
    _, judged = rover_path(name, *settings)
    away = np.linspace(0.0, 6.0, 600)[:, None] * np.array([np.cos(direction), np.sin(direction)])
    assert judged(away) == "left the path"


@pytest.mark.parametrize("radius", [1.0, 2.0])
@pytest.mark.parametrize("share", [0.01, 0.3])
def test_a_rover_that_circles_about_the_centre_has_left_its_path(radius: float, share: float) -> None:
    """It goes round as its path does, but on a fraction of the radius: no part of the path is its own."""
    _, judged = rover_path("rover-figure-of-eight", f"course.radius={radius}")
    entry = np.column_stack([np.linspace(0.0, 1.3, 50), np.zeros(50)])
    inwards = np.linspace([1.3, 0.0], [1.3, (1.0 - share) * radius], 100)
    angle = np.linspace(0.0, 2.0 * np.pi, 400)
    around = np.column_stack([1.3 + share * radius * np.sin(angle), radius * (1.0 - share * np.cos(angle))])
    assert judged(np.vstack([entry, inwards, around])) == "left the path"


@pytest.mark.parametrize(("name", "settings"), ROVER_COURSES)
def test_a_rover_on_its_path_completes_it(name: str, settings: tuple[str, ...]) -> None:
    parts, judged = rover_path(name, *settings)
    poses = [parts.path.pose(s) for s in np.linspace(0.0, parts.path.length + 0.1, 2000)]
    beside = np.array([(pose.x - 0.3 * np.sin(pose.psi), pose.y + 0.3 * np.cos(pose.psi)) for pose in poses])
    assert judged(beside) == "completed"


def test_a_tractor_that_takes_the_wrong_circle_has_left_the_road() -> None:
    """On a figure of eight it turns right where left is due: the wheels stay on the road, but not on the course."""
    parts = assemble(load_scenario("figure-of-eight", QUICK), seed=1)
    path, (x_ref, y_ref) = parts.course.path, parts.course.reference
    n_units, middle = len(parts.vehicle.units), 0.5 * path.length
    judge = CourseJudge(parts)
    assert judge.progress == 0.0
    stations = [*np.arange(0.0, middle / 3.0, 0.5), *np.arange(middle, path.length, 0.5)]

    def outcome(station: float) -> str | None:
        pose = path.pose(station)
        tractor = pose @ Pose2(-x_ref, -y_ref, 0.0)  # so that its guided point is on the path
        truth: Any = SimpleNamespace(
            tick=0, poses=np.tile(tractor, (n_units, 1)), load_transfer=np.zeros(n_units), velocities=np.zeros((2, 3))
        )
        return judge.outcome(truth)

    outcomes = [outcome(station) for station in stations]
    ended = next(found for found in outcomes if found)
    assert ended == "left the road"


@pytest.mark.parametrize("duration", [float("inf"), float("nan"), 0.0])
def test_a_driver_without_an_end_is_refused(duration: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(PreviewDriver, "duration", property(lambda self: duration))
    with pytest.raises(
        ValueError, match=rf"^driver.kind = preview: duration = {duration} s must be positive and finite"
    ):
        assemble(load_scenario("cambered-road", QUICK), seed=1)
