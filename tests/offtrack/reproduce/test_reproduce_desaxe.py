"""`offtrack reproduce`: what is made and refused; drives of de Saxe & Cebon (2018), and what an interrupt leaves."""

import dataclasses
import json
import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
import typer
from matplotlib.figure import Figure
from typer.testing import CliRunner

from estimators.context import RoverContext
from estimators.estimates import SlipAngle, lost_slip
from offtrack.commands.assess import reproduce
from offtrack.studies.reproduce import desaxe2018 as drives
from offtrack.studies.reproduce import desaxe2018_field, reproduction, trace_tables
from offtrack.studies.reproduce.desaxe2018 import Case, Drive, Facing, Outcome, Point, Track
from offtrack.studies.reproduce.reproduction import (
    REPRODUCTIONS,
    Comparison,
    Reproduction,
    maker,
    names_of,
    printed,
    write_reproduction,
)
from offtrack.studies.reproduce.trace_tables import TraceSet, evaluated, trace_log
from scenarios.assembly.adapters import course_of
from scenarios.loop.runner import run
from scenarios.options.scenario import load_scenario
from scenarios.progress import Progress, no_progress
from scenarios.results.log import Log, Signal, read_log, read_table
from sensors.camera.rig import StereoRig
from sensors.messages import RoverView, StereoFrame
from sensors.world.ground import Centreline, Landscape, road_map
from sensors.world.scenery import grain_fields, patched
from vehicle.combination.description import load_vehicle
from vehicle.frames import FloatArray
from vehicle.surface import Surface

pytestmark = pytest.mark.usefixtures("worlds")
FACINGS: tuple[Facing, ...] = ("rear", "left")
FIGURES = sorted(name for name in REPRODUCTIONS if name.startswith("desaxe2018") and not name.endswith("fig13"))


def made_up(case: Case, error: Callable[[FloatArray], FloatArray]) -> Drive:
    """A drive of 20 s at 4 m/s with an off-tracking that swings by 3 m, and estimates that are off by ``error``."""
    time, full = 0.1 * np.arange(200.0), partial(np.full, 200)
    true, off = 3.0 * np.sin(time), error(time)
    track = Track(
        off_tracking=true + off, std=full(0.01), matches=full(300.0), inliers=full(240.0), lateral=np.gradient(off)
    )
    return Drive(
        case=case, time=time, true=true, reference=true, lateral=np.zeros(200), speed=full(4.0),
        tracks=dict.fromkeys(case.odometries, track),
    )  # fmt: skip


@pytest.fixture
def cheap(monkeypatch: pytest.MonkeyPatch) -> list[Case]:
    """Drives that cost nothing, all of them 2 cm off; what was asked for."""
    asked: list[Case] = []

    def drive(case: Case, progress: Progress) -> Drive:
        asked.append(case)
        progress(1.0, 1.0)
        return made_up(case, lambda time: np.full(len(time), 0.02))

    monkeypatch.setattr(drives, "drive", drive)
    monkeypatch.setattr(drives, "default_jobs", lambda: 1)  # workers would not know of it
    monkeypatch.setattr(drives, "_DRIVES", {})
    return asked


def make(name: str, *, quick: bool = False) -> Reproduction:
    return maker(name)(quick, no_progress)


@pytest.mark.slow
@pytest.mark.parametrize("name", FIGURES)
def test_every_figure_is_drawn_and_written(name: str, cheap: list[Case], tmp_path: Path) -> None:
    """Published numbers stand beside own ones; picture and data come of the same drives, of scenarios that can be."""
    made = make(name)
    write_reproduction(made, tmp_path / "made", {})
    assert made.name == name
    assert any(one.published for one in made.comparisons)
    unknown = [one.quantity for one in made.comparisons if not math.isfinite(one.own)]
    # no baseline is short of matches here, and an error that never changes has nothing to explain
    assert all("under 250 matches" in quantity or quantity.startswith("share") for quantity in unknown)
    assert len(read_table(tmp_path / "made" / f"{name}.parquet")) > 0
    assert (tmp_path / "made" / f"{name}.png").stat().st_size > 20_000
    make(name, quick=True)
    assert {load_scenario(case.scenario, case.settings).trailer_steering for case in cheap} == {"none"}


def test_drives_are_shared_and_come_back_in_order(cheap: list[Case], monkeypatch: pytest.MonkeyPatch) -> None:
    """The nine panels of Figs 14 and 16 are six drives; cases come back in order, whatever is finished first."""
    make("desaxe2018-fig14")
    make("desaxe2018-fig16")
    assert len(cheap) == 6
    cases = [Case(scenario="constant-slip", seed=seed) for seed in (3, 1, 2, 1)]
    steps: list[tuple[float, float]] = []
    monkeypatch.setattr(drives, "default_jobs", lambda: 2)
    monkeypatch.setattr(drives, "as_finished", lambda work, tasks, jobs: ((task, work(task)) for task in tasks[::-1]))
    for _ in range(2):
        driven = drives.driven(cases, lambda done, total, note="": steps.append((done, total)))
        assert [one.case.seed for one in driven] == [3, 1, 2, 1]
    assert steps[:4] == [(0, 300), (100, 300), (200, 300), (300, 300)]
    assert len(cheap) == 9


def test_figure_6_has_the_papers_baselines_and_the_errors_of_the_estimates(cheap: list[Case]) -> None:
    """0.5 to 5.0 m, to the rear and to a side; estimates that are all 2 cm off have an RMS and a mean of 2 cm."""
    own = {one.quantity: one.own for one in make("desaxe2018-fig6").comparisons}
    points = [Point(facing=facing, baseline=0.5 * k) for facing in FACINGS for k in range(1, 11)]
    assert cheap == [point.case(quick=False) for point in points]
    for name in ("RMS", "mean"):
        # exact up to the rounding of sums over 200 images
        assert own[f"rear, up to 2.5 m: largest {name} error"] == pytest.approx(0.02, abs=1e-12)


def test_interrupt_keeps_the_finished_drives(cheap: list[Case], monkeypatch: pytest.MonkeyPatch) -> None:
    """After two drives somebody presses Ctrl-C: the figure has these two, and says so."""
    finished = drives.drive

    def third_is_interrupted(case: Case, progress: Progress) -> Drive:
        if len(cheap) == 2:
            raise KeyboardInterrupt
        return finished(case, progress)

    monkeypatch.setattr(drives, "drive", third_is_interrupted)
    made = make("desaxe2018-fig6")
    assert made.interrupted
    assert set(made.data["baseline"]) == {0.5, 1.0}
    assert any("2 of 20" in note for note in made.notes)


def test_views_show_the_matches_on_both_images(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cameras at rest before a wall of noise: matches are 8 px further left in the right image, and have not moved."""
    wall = np.random.default_rng(0).integers(40, 200, (391, 1352)).astype(np.uint8)
    wall = np.asarray(cv2.GaussianBlur(wall, (0, 0), 1.5))
    frames = [StereoFrame(tick=100 * k, left=wall[:, :-8], right=wall[:, 8:]) for k in range(4)]
    calibration = StereoRig(
        facing="rear", width=1344, height=391, hfov=math.radians(100.0), x=-14.0, y=0.0, z=3.0, baseline=0.5
    ).calibration()
    matches = desaxe2018_field.matched_features(calibration, frames)
    assert len(matches.current) > 300
    assert np.mean(matches.current[:, 0] - matches.current[:, 2] == 8.0) > 0.99
    assert np.mean(np.all(matches.current == matches.previous, axis=1)) > 0.99
    view = desaxe2018_field.View(facing="rear", left=frames[0].left, right=frames[0].right, matches=matches)
    monkeypatch.setattr(desaxe2018_field, "view_of", lambda facing, until, progress: view)
    made = make("desaxe2018-fig13")
    write_reproduction(made, tmp_path / "made", {})
    data = read_log(tmp_path / "made" / "desaxe2018-fig13.parquet")
    assert np.array_equal(data["u_right"][: len(matches.current)], matches.current[:, 2])
    assert made.comparisons[0].own == len(matches.current)


def test_drift_is_explained_by_the_motion_it_adds_up_from() -> None:
    """A burst of biased motion shows in the off-tracking until it is one trailer length back, 14 m or 3.5 s."""
    case = Point().case(quick=True)
    burst = np.zeros(200)
    burst[50:60] = 0.008
    summed = np.cumsum(burst) - np.cumsum(np.concatenate([np.zeros(35), burst[:-35]]))
    drive = made_up(case, lambda time: summed)
    track = dataclasses.replace(drive.tracks["viso2"], lateral=burst)
    drive = dataclasses.replace(drive, tracks={"viso2": track, "keyframe": track})
    assert drives.explained_share(drive) > 0.99  # 14 m are 35 images; rounding of the way remains
    assert Outcome.of(Point(), drive, "viso2").largest == pytest.approx(0.08)


def test_bias_is_told_apart_by_side() -> None:
    """An error that is there for a path on the right only, as the paper's, is a bias of that side only."""
    case = desaxe2018_field.FieldTest("left roundabout").case(quick=True)
    drive = made_up(case, lambda time: np.where(np.sin(time) < 0.0, 0.2, 0.0))
    assert desaxe2018_field.biases(drive, "viso2") == pytest.approx((0.0, 0.2))


@pytest.mark.slow
def test_field_tests_are_driven_as_in_the_paper() -> None:
    """40 km/h before the turn, 15 km/h in it, and 3.3 m of off-tracking: the paper's 0.11 m are 3.3 % of it.

    In a left turn the trailer cuts in to the left, so that the hitch's path is on its right.
    """
    settings = [
        "off_tracking=truth",
        "course.turn_deg=270",
        "course.entry=80",
        "course.exit=5",
        "surface.roughness=none",
    ]
    result = run(load_scenario("field-roundabout-left", settings), 1)
    assert result.outcome == "completed"
    speed, true = 3.6 * result.log["v_x_tractor"], result.log["off_tracking_true"]
    assert speed.max() == pytest.approx(40.0, abs=0.5)  # his integral overshoots a little
    assert speed.min() == pytest.approx(13.5, abs=2.0)  # of the rear axle, inside the guided corner's circle
    assert np.nanmin(true) == pytest.approx(-3.3, abs=0.15)  # designed without slip, of which there is a degree


@pytest.mark.parametrize(("side", "sign"), [("left", 1.0), ("right", -1.0)])
def test_field_roundabouts_go_round_three_times(side: str, sign: float) -> None:
    """Three full turns per manoeuvre: more than one segment of a path can hold."""
    scenario = load_scenario(f"field-roundabout-{side}")
    path = course_of(scenario, load_vehicle(scenario.vehicle)).path
    bends = [path.curvature(float(s)) for s in np.arange(0.0, path.length, 0.01)]
    assert 0.01 * sum(bends) == pytest.approx(sign * 6.0 * math.pi, rel=1e-3)  # 1 cm at both ends of 236 m


def test_figure_of_eight_comes_back_to_where_it_was() -> None:
    """Three figures lie on one another to within the tarmac: 40 m wide, of which the combination needs 8 m."""
    scenario = load_scenario("field-figure-of-eight")
    path = course_of(scenario, load_vehicle(scenario.vehicle)).path
    one = 2.0 * (11.35 * math.radians(225.6) + 4.0 + 50.0)  # loops, of them 4 m more for their ramps, and straights [m]
    starts = np.array([path.pose(100.0 + k * one) for k in range(3)])
    assert np.hypot(*(starts[:, :2] - starts[0, :2]).T).max() < 2.0
    assert np.ptp(starts[:, 2]) < math.radians(0.1)  # as far left as right


def test_grain_stands_beside_the_tarmac_and_patches_lie_on_it() -> None:
    """Beds of crop keep off the tarmac's whole width; mended places change nothing beside it."""
    line = Centreline(np.array([[0.0, 0.0], [60.0, 0.0]]), 20.0)
    low, high = np.array([-40.0, -60.0]), np.array([100.0, 60.0])
    landscape = Landscape(np.random.default_rng(1), Surface(friction=0.8), low, high)
    grain = grain_fields(np.random.default_rng(2), line, landscape)
    assert len(grain.poses) > 100
    clear = line.distance(grain.poses[:, :2, 3]) - grain.thing.radius
    assert clear.min() > 20.0 - 0.5  # ears at the corners reach a little further
    road = road_map(np.random.default_rng(3), line, low, high)
    mended = patched(np.random.default_rng(4), road, 6.0)
    on_it = road.edge_distance < 0.0
    assert np.array_equal(mended.gravel[~on_it], road.gravel[~on_it])
    assert 0.05 < np.mean(mended.gravel[on_it] != road.gravel[on_it]) < 0.5  # 6 of some 2 m2 on 100 m2


APP = typer.Typer(pretty_exceptions_enable=False)
APP.command()(reproduce)


@pytest.mark.slow
def test_table_2_writes_picture_data_and_numbers(tmp_path: Path) -> None:
    """Ten candidates beside ten published ones, best first; the confidences spread as widely as the paper's."""
    out = tmp_path / "made"
    result = CliRunner().invoke(APP, ["reina2008-table2", "--quick", "--json", "--out", str(out)])
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    written = json.loads((out / "reina2008-table2.json").read_text())
    assert told["numbers"] == written["numbers"]
    assert [float(one["published"]) for one in told["numbers"]] == sorted(
        printed("reina2008")["table2"]["confidences"], reverse=True
    )
    own = [one["own"] for one in told["numbers"] if one["own"] is not None]
    assert own == sorted(own, reverse=True)
    assert own[0] > 80.0  # the trace is clear, and followed from image to image
    assert own[-1] < 50.0  # other candidates are not the trace
    data = read_log(out / "reina2008-table2.parquet")
    assert 100.0 * np.sort(data["confidence"])[::-1] == pytest.approx(own)
    assert (out / "reina2008-table2.png").stat().st_size > 5_000


def test_sets_have_the_papers_numbers_of_images() -> None:
    """Table III: 1560 images of set A and 3456 of set B, 5016 in all."""
    sets = [TraceSet(**one) for one in printed("reina2008")["table3"]["sets"]]
    assert [len(one.kinds) * len(one.seeds) * one.frames for one in sets[:2]] == [1560, 3456]


@pytest.mark.slow
def test_trace_sets_are_counted_apart_and_every_image_is_kept() -> None:
    """Two short ones with a tracker of one's own that sees no trace anywhere: nothing false, everything missed."""
    short = TraceSet(name="short", kinds=("uniform",), seeds=(101,), frames=4, profile="none", slope_deg=0.0)
    steps: list[tuple[float, float, str]] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trace_tables, "default_jobs", lambda: 1)
        sets = (short, replace(short, name="longer", frames=6))
        data = trace_log(evaluated(sets, f"{__name__}:Blind", lambda *step: steps.append(step)))
    assert data["frame"].tolist() == [*range(4), *range(6)]
    assert data["set"].tolist() == [0] * 4 + [1] * 6
    assert not data["detected"].any()
    assert steps[-1][:2] == (10, 10)


class Blind:
    @classmethod
    def of(cls, context: RoverContext) -> "Blind":
        return cls()

    def init(self) -> None:
        """Nothing to remember."""

    def step(self, memory: None, view: RoverView) -> tuple[None, SlipAngle]:
        return None, lost_slip(view.tick)


@pytest.mark.parametrize("name", REPRODUCTIONS)
def test_every_entry_of_the_catalogue_can_be_loaded(name: str) -> None:
    assert callable(maker(name))
    assert name in names_of("all")


@pytest.mark.parametrize(("kept", "folders"), [(True, 2), (False, 1)])
def test_interrupt_of_all_keeps_what_is_finished_and_stops(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kept: bool, folders: int
) -> None:
    """Ctrl-C in the second figure: the first is there, of the second what is finished, and no third is begun."""
    begun: list[str] = []
    data = Log((Signal("time", "s", "time"),), np.zeros((1, 1)))
    numbers = [Comparison(quantity="a number", published="1", own=2.0, unit="-")]

    def made(name: str) -> reproduction.Maker:
        def make(quick: bool, progress: Progress) -> Reproduction:
            begun.append(name)
            if len(begun) == 2 and not kept:
                raise KeyboardInterrupt
            texts = {"name": name, "title": "a figure", "source": "a paper"}
            second = len(begun) == 2
            return Reproduction(**texts, comparisons=numbers, notes=(), data=data, draw=Figure, interrupted=second)

        return make

    monkeypatch.setattr(reproduction, "maker", made)
    result = CliRunner().invoke(APP, ["all", "--quiet", "--out", str(tmp_path)])
    assert result.exit_code == 130
    assert begun == list(REPRODUCTIONS)[:2]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(begun[:folders])
    marks = [json.loads((tmp_path / name / f"{name}.json").read_text())["interrupted"] for name in begun[:folders]]
    assert marks == [False, True][:folders]
    again = CliRunner().invoke(APP, ["all", "--json", "--out", str(tmp_path)])
    assert again.exit_code == 0, again.stderr
    assert begun[2:] == list(REPRODUCTIONS)[1:]  # the unfinished one, and the others
    assert [one["name"] for one in json.loads(again.stdout)] == list(REPRODUCTIONS)
    assert (again.stderr.count("\n"), "finished earlier" in again.stderr) == (1, True)
