"""Vehicles that tow nothing: their front axle leads, their rear follows, and laws steer their own rear axles."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from controllers.trailer import Combination
from controllers.trailer_steering.kinematics import hitch_motion
from controllers.trailer_steering.signal_laws import CommandSteer
from offtrack.commands.cli import app
from scenarios.assembly.adapters import trailer_geometry
from scenarios.loop.runner import run
from scenarios.options.scenario import load_scenario
from scenarios.results.trailer_result import RunResult, swept
from sensors.instruments.navigation import DriverPerception
from tests.trailers import signals as readings
from vehicle.combination.description import load_vehicle
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.frames import Pose2
from vehicle.surface import Surface

CRANE = ("vehicle=mobile_crane_5_axle", "off_tracking=truth", "reference_unit=false")


def driven(law: str, *settings: str) -> RunResult:
    return run(load_scenario("roundabout", [*CRANE, f"trailer_steering={law}", *settings]), 1)


@pytest.fixture(scope="module")
def straight() -> RunResult:
    return driven("none", "course.turn_deg=270")


@pytest.fixture(scope="module")
def steered() -> RunResult:
    return driven("path_preview", "course.turn_deg=270")


@pytest.mark.parametrize("name", ["rigid_truck_8x4", "mobile_crane_5_axle"])
def test_the_origin_of_the_frame_changes_no_motion(name: str) -> None:
    """The same drive of a vehicle in the frame of its file, and in one at its front axle: equal places of that axle."""
    whole, led = load_vehicle(name), load_vehicle(name).led()
    ahead = led.units[0].origin_x
    places = []
    for vehicle, x in ((whole, ahead), (led, 0.0)):
        plant = Plant(vehicle, Surface(friction=0.8))
        state = plant.initial_state(Pose2(-x, 0.0, 0.0), 5.0)
        command = VehicleCommand(0.3, 0.2, (-0.1,) * vehicle.n_by_law)
        for _ in range(300):
            state = plant.step(state, command, 10)
        truth = plant.observe(state, 3000)
        places.append((Pose2(*truth.poses[0]) @ Pose2(x, 0.0, 0.0), truth))
    (first, in_file), (second, at_axle) = places
    assert tuple(second) == pytest.approx(tuple(first), abs=1e-4)  # two integrations of stiff tyres
    np.testing.assert_allclose(at_axle.wheel_loads, in_file.wheel_loads, rtol=1e-3)
    ego, seen = DriverPerception().sample(in_file), DriverPerception(ahead).sample(at_axle)
    assert (seen.x, seen.y, seen.v_x, seen.v_y) == pytest.approx((ego.x, ego.y, ego.v_x, ego.v_y), abs=1e-4)


@pytest.mark.slow
def test_straight_rear_axles_cut_in_by_the_closed_form(straight: RunResult) -> None:
    """Axles that spread by t about L behind the front act as one at L + t^2 / L; the body turns about a point beside.

    With it at the distance y to the side, the path of the front axle lies sqrt(y^2 + f (2 L - f)) - y to the outside of
    a follow point f behind that axle.
    """
    front, corner, width, follow = 5.75, 7.7, 2.75, 5.75 + 3.2
    length = front + 2.0 * 1.65**2 / 3.0 / front
    across = math.sqrt(12.5**2 - (corner - front + length) ** 2) - 0.5 * width
    cut_in = math.sqrt(across**2 + follow * (2.0 * length - follow)) - across
    assert straight.outcome == "completed"
    deepest = float(np.nanmin(straight.log["off_tracking_true"]))
    assert deepest == pytest.approx(-cut_in, rel=0.05)  # tyres slip a little; the driver rounds the entry


@pytest.mark.slow
def test_a_law_that_steers_the_own_rear_axles_keeps_the_rear_on_the_path(
    straight: RunResult, steered: RunResult
) -> None:
    """The follow point retraces the front axle's path, and the swept path gets narrower by a metre and more."""
    true = steered.log["off_tracking_true"]
    assert np.sqrt(np.nanmean(true**2)) < 0.03
    assert np.nanmax(np.abs(true)) < 0.15  # at the entry, by the rate limit of the rear axles
    widths = [swept(result).max_width for result in (straight, steered)]
    assert widths[1] < widths[0] - 1.0
    steady = np.degrees(steered.log["steer_trailer_3_crane"][np.nanargmax(steered.log["psi_crane"] > math.pi)])
    middle = 0.5 * (5.75 + 3.2)  # the turning point lies beside the middle between front axle and follow point
    across = math.sqrt(12.5**2 - (7.7 - 5.75 + middle) ** 2) - 0.5 * 2.75
    assert steady == pytest.approx(-math.degrees(math.atan((5.75 + 1.65 - middle) / across)), abs=1.5)
    assert {"steer_tractor", "steer_tractor_2", "steer_trailer_1_crane"} <= set(steered.log.names)
    assert not any(name.startswith("articulation") for name in steered.log.names)


def test_the_front_wheels_say_where_the_leading_point_goes() -> None:
    """In place of an articulation angle; command steer then turns the rear axles as a linkage from the front would."""
    vehicle = load_vehicle("mobile_crane_5_axle").led()
    combination, geometry = Combination(vehicle, 0), trailer_geometry(vehicle, 0)
    signals = readings(
        20, angles=np.zeros(3), speed=2.0, steer=0.3, articulation=np.zeros(0), yaw_rates=np.array([0.1])
    )
    assert hitch_motion(combination, signals).direction == pytest.approx(0.3)
    law = CommandSteer(geometry, combination=combination)
    memory = law.init()
    for tick in range(0, 4000, 20):
        memory, command = law.step(memory, tick, None, signals)
    middle = 0.5 * geometry.follow_distance
    expected = [-math.atan((x - middle) / middle * math.tan(0.3)) for x in (4.1, 5.75, 7.4)]
    np.testing.assert_allclose(command.angles, expected, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("law", ["command_steer", "virtual_driver", "ct_at"])
def test_other_laws_steer_it_too(law: str) -> None:
    result = driven(law, "course.turn_deg=90", "course.exit=10")
    assert result.outcome == "completed"
    assert np.abs(result.log["steer_trailer_3_crane"]).max() > math.radians(8.0)


@pytest.mark.parametrize(
    ("settings", "line"),
    [
        (("trailer_steering=mpc",), "mpc: models a trailer behind a hitch, and mobile_crane_5_axle tows nothing"),
        (("trailer_steering=lqr",), "lqr: models a trailer behind a hitch, and mobile_crane_5_axle tows nothing"),
        (("off_tracking=kinematic",), "unit = 0 must be a towed unit of mobile_crane_5_axle"),
        (("vehicle=rigid_truck_8x4",), "path_preview: the trailer has no steered axle"),
    ],
)
def test_parts_that_need_a_hitch_are_refused_in_one_line(settings: tuple[str, ...], line: str) -> None:
    with pytest.raises(ValueError, match=line) as refusal:
        run(load_scenario("roundabout", [*CRANE, *settings]), 1)
    assert "\n" not in str(refusal.value)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "settings"),
    [
        ("turn-90", ("vehicle=mobile_crane_5_axle", "trailer_steering=virtual_driver")),
        ("roundabout", ("vehicle=rigid_truck_8x4", "trailer_steering=none", "course.turn_deg=90")),
    ],
)
def test_a_run_has_its_report_page_and_summary(scenario: str, settings: tuple[str, ...], tmp_path: Path) -> None:
    """By a vehicle's name alone; the page names the front axle where that of a trailer names the hitch."""
    keys = [word for setting in ("off_tracking=truth", *settings) for word in ("--set", setting)]
    result = CliRunner().invoke(app, ["run", scenario, *keys, "--out", str(tmp_path / "run"), "--no-video", "--quiet"])
    assert result.exit_code == 0, result.output
    numbers = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert numbers["outcome"] == "completed"
    assert numbers["off_tracking"]["true_max_m"] > 0.0
    page = (tmp_path / "run" / "report.html").read_text()
    assert "path of the front axle" in page
    assert "path of the hitch" not in page
