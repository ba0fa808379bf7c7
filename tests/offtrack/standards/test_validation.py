"""The validation: its closed_forms are right, its verdicts honest, its page and command complete."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from typer.testing import CliRunner

from controllers.path import Path as Course
from controllers.path import arc
from offtrack.commands import assess
from offtrack.commands.assess import validate
from offtrack.studies.validation import no_slip_limit, suite, turns_without_slip
from offtrack.studies.validation.check import Check, CheckSection, Plot, Series, number
from offtrack.studies.validation.equations import OtherStepPlant
from offtrack.studies.validation.no_slip_limit import NoSlipChain, poses_along
from offtrack.studies.validation.simple_drives import on_single_axles
from offtrack.studies.validation.suite import validation_page
from vehicle.clock import TICK
from vehicle.combination.description import load_vehicle
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.frames import Pose2
from vehicle.surface import Surface

FOOT = 0.3048

# --- closed_forms ---


@given(st.floats(1.05, 5.0), st.floats(0.1, 6.0))
def test_the_tractrix_solves_its_equation(ratio: float, turned: float) -> None:
    """gamma' = 1 - (R / L) sin(gamma) from 0, integrated numerically."""
    end = solve_ivp(lambda _, g: 1.0 - ratio * np.sin(g), (0.0, turned), [0.0], rtol=1e-10, atol=1e-12).y[0, -1]
    assert turns_without_slip.tractrix_articulation(ratio, 1.0, turned) == pytest.approx(
        end, abs=1e-8
    )  # of the integration


def test_steady_forms_have_the_values_known_for_them() -> None:
    """Off-tracking of follow point and axle, the path-following law's own geometry, the ring's longest wheelbase."""
    assert turns_without_slip.follow_point_off_tracking(15.0, 9.0, 14.0) == pytest.approx(2.142135, abs=1e-6)
    known = {12.5: 3.3830, 15.0: 2.6765, 20.0: 1.9205, 30.0: 1.2447, 50.0: 0.7367, 100.0: 0.3663}
    for radius, off_tracking in known.items():
        found = turns_without_slip.front_axle_off_tracking(radius, 3.8, 0.7744762, 7.7)
        assert found == pytest.approx(off_tracking, abs=5e-5)  # rounding of the known
    for width, length in ((2.55, 8.135), (2.50, 8.155), (2.60, 8.115)):
        assert turns_without_slip.longest_wheelbase_on_the_roundabout(width) == pytest.approx(length, abs=5e-4)


@given(st.floats(9.0, 50.0), st.floats(0.0, 1.0))
def test_path_following_axles_point_along_the_trailers_turn(radius: float, share: float) -> None:
    """Hitch and follow point on one circle: every axle stands square to the radius through it."""
    follow = 14.0
    centre = np.array([-0.5 * follow, math.sqrt(radius**2 - 0.25 * follow**2)])  # of the turn, in the trailer's frame
    axle = np.array([-share * follow, 0.0])
    delta = turns_without_slip.path_following_steer(radius, share * follow, follow)
    assert (centre - axle) @ np.array([math.cos(delta), math.sin(delta)]) == pytest.approx(0.0, abs=1e-9 * radius)


def test_rolling_without_slip_goes_on_over_several_hitches() -> None:
    """Units of a train on a long circle settle on radii from right triangles; a hitch off the axle widens the next."""
    radius = 20.0  # of the tractor's rear axle, guided in front of it
    front = 4.0
    guided = math.hypot(radius, front)
    circle = Course(Pose2(front, 0.0, 0.0), (arc(2.0 * math.pi * guided, 1.0 / guided),) * 4)
    chain = NoSlipChain((0.6, -9.0), (7.0, 4.0))
    now = poses_along(chain, circle, (front, 0.0))[-1]
    first = math.sqrt(radius**2 + 0.6**2 - 7.0**2)
    second = math.sqrt(first**2 + 2.0**2 - 4.0**2)  # the hitch is 2 m behind the axle
    centre = now[0, :2] + radius * np.array([-math.sin(now[0, 2]), math.cos(now[0, 2])])
    for pose, length, expected in zip(now[1:], chain.lengths, (first, second), strict=True):
        axle = pose[:2] - length * np.array([math.cos(pose[2]), math.sin(pose[2])])
        assert np.hypot(*(axle - centre)) == pytest.approx(expected, abs=1e-3)  # it starts with a kink at the front


# --- checks ---


def check(value: float | None, *, target: float = 1.0, tolerance: float = 0.1, remark: str = "") -> Check:
    return Check(
        name="radius of <the> turn", value=value, target=target, tolerance=tolerance, unit="m", source="a & b",
        remark=remark,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("value", "verdict"),
    [(1.0, "passed"), (1.09, "passed"), (0.91, "passed"), (1.11, "failed"), (0.89, "failed"), (math.nan, "failed"),
     (math.inf, "failed"), (None, "skipped")],
)  # fmt: skip
def test_a_value_passes_within_its_tolerance(value: float | None, verdict: str) -> None:
    """To both sides; what is no number fails, what could not be had is skipped."""
    assert check(value).verdict == verdict


@pytest.mark.parametrize(
    ("value", "tolerance", "text"),
    [(7.4113, 0.1, "7.41"), (2.142136, 1e-3, "2.1421"), (0.0, 1e-9, "0"), (3.2e-14, 1e-9, "3.2e-14"),
     (-2e-4, 1.0, "-0.0002"), (4e-13, 1e-12, "4e-13"),
     (math.nan, 1.0, "nan"), (149.6, 10.0, "150"), (1234.5, 1000.0, "1234")],
)  # fmt: skip
def test_numbers_show_the_digits_their_tolerance_makes_meaningful(value: float, tolerance: float, text: str) -> None:
    """The tolerance's first digit and one more; two digits of what is small beside it."""
    assert number(value, tolerance) == text


# --- the suite, with fewer cases ---

QUICK = {"Tractrix", "Linear theory", "Multibody model", "Mechanics"}  # take less than 1 s


@pytest.mark.parametrize(
    "title", [pytest.param(title, marks=() if title in QUICK else pytest.mark.slow) for title in suite.TASKS]
)
def test_all_values_are_within_the_tolerance_of_their_target(title: str) -> None:
    """Physics that the suite proves is tested by nothing else."""
    checks = suite.TASKS[title](True).checks
    assert [(one.name, one.value, one.target) for one in checks if one.verdict != "passed"] == []
    assert all(one.source for one in checks)


def test_a_package_that_is_missing_is_said_to_be(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(no_slip_limit, "installed", lambda: False)
    for one in no_slip_limit.slalom_checks():
        assert one.verdict == "skipped"
        assert "pip install commonroad-vehicle-models" in one.remark


# --- the vehicles and the plant it uses ---


def test_an_axle_in_the_middle_of_a_group_carries_its_load() -> None:
    """The tridem as one axle: the same loads on steer axle, drive axle and group, the same place of the group."""
    vehicle = load_vehicle("eu_tractor_semitrailer")
    single = on_single_axles(vehicle)
    before, after = (static_axle_loads(each) for each in (vehicle, single))
    assert after[0] == pytest.approx(before[0], rel=1e-9)
    assert after[1] == pytest.approx([sum(before[1])], rel=1e-9)
    group, axle = vehicle.units[1].axles, single.units[1].axles[0]
    assert axle.tyre.nominal_load / group[0].tyre.nominal_load == pytest.approx(3.0)  # tyres as heavily loaded
    assert axle.x == pytest.approx(np.mean([one.x for one in group]))


def test_other_steps_are_the_plants_own_where_they_are_as_long() -> None:
    """At 1 ms it is the same step, so that what another step changes is the step's."""
    vehicle = load_vehicle("uk_longer_semitrailer")
    command = VehicleCommand(0.1, -1.0, (0.05, 0.1))
    plants = Plant(vehicle, Surface(friction=0.6)), OtherStepPlant(vehicle, 0.6, TICK)
    ends = [plant.step(plant.initial_state(Pose2(1.0, 2.0, 0.3), 8.0), command, 200) for plant in plants]
    np.testing.assert_allclose(ends[1], ends[0], rtol=1e-9, atol=1e-9)  # two compilers' rounding, 200 steps


# --- page and command ---


def section(*values: float | None) -> CheckSection:
    series = (Series("model", np.arange(3.0), np.arange(3.0) ** 2, "model"),)
    plot = Plot(title="a < b", x_label="x [m]", y_label="y [m]", to_scale=True, series=series)
    checks = tuple(check(value, remark="not installed" if value is None else "") for value in values)
    return CheckSection(title="Turns", text="Slowly round.", checks=checks, plots=(plot,))


def test_the_page_says_everything() -> None:
    page = validation_page([section(1.05, 1.2, None)], {"python": "3.x"})
    for text in ("1.05 m", "1.20 m", "1.00 m", "± 0.1", "a &amp; b", "radius of &lt;the&gt; turn (not installed)",
                 "1 passed, 1 failed, 1 skipped", "a &lt; b", "Slowly round.", "<svg", "3.x"):  # fmt: skip
        assert text in page, text


@pytest.mark.parametrize(
    ("values", "verdicts"), [((1.05, None), (1, 0, 1)), ((1.05, 1.2), (1, 1, 0)), ((1.05, math.nan, None), (1, 1, 1))]
)
def test_the_command_writes_a_page_and_fails_when_a_number_is_out(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, values: tuple[float | None, ...], verdicts: tuple[int, int, int]
) -> None:
    """Exit code 0 if everything is in its tolerance, or skipped; the page is there all the same: it shows which.

    JSON is all that is printed.
    """
    monkeypatch.setattr(assess, "TASKS", {"Turns": lambda quick: section(*values)})
    app = typer.Typer()
    app.command()(validate)
    done = CliRunner().invoke(app, ["--json", "--out", str(tmp_path / "new" / "one")])
    assert done.exit_code == bool(verdicts[1]), done.output
    told = json.loads(done.stdout)
    assert (told["passed"], told["failed"], told["skipped"]) == verdicts
    assert [one["name"] for one in told["checks"]] == ["radius of <the> turn"] * len(values)
    assert {"section", "value", "target", "tolerance", "unit", "source", "verdict"} <= set(told["checks"][0])
    assert (tmp_path / "new" / "one" / "validation.html").read_text(encoding="utf-8").startswith("<!doctype html>")
    assert json.loads((tmp_path / "new" / "one" / "validation.json").read_text(encoding="utf-8")) == told
