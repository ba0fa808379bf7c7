"""Several steered trailers in one loop, steer groups, no-slip estimates, and recorded drives."""

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
from offtrack.reports.run_page import report_html
from scenarios.assembly.adapters import trailer_geometry
from scenarios.assembly.drivers_and_laws import read_trace
from scenarios.loop.runner import run
from scenarios.options.scenario import load_scenario
from scenarios.results.trailer_result import RunResult, swept, trailer_summaries
from sensors.instruments.navigation import DriverPerception
from tests.trailers import signals as readings
from vehicle.combination.description import load_vehicle
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.frames import Pose2
from vehicle.surface import Surface

DOUBLE = ("vehicle=b_double_steered", "course.turn_deg=60", "course.exit=10", "reference_unit=false")


@pytest.fixture(scope="module")
def double() -> RunResult:
    return run(load_scenario("roundabout", (*DOUBLE, "off_tracking=truth")), 1)


@pytest.mark.slow
def test_each_trailer_follows_its_own_hitch(double: RunResult) -> None:
    """Both follow points keep within 5 cm, where unsteered ones cut in by half a metre: 60 deg of the 12.5 m circle."""
    of_each = trailer_summaries(double)
    unsteered = run(load_scenario("roundabout", (*DOUBLE, "off_tracking=truth", "trailer_steering=none")), 1)
    assert list(of_each) == ["lead trailer", "semitrailer"]
    for name, numbers in of_each.items():
        assert numbers["true_max_m"] is not None
        assert numbers["true_max_m"] < 0.05
        cut_in = trailer_summaries(unsteered)[name]["true_max_m"]
        assert cut_in is not None
        assert cut_in > 0.4


def test_the_summary_is_of_the_worst_trailer(double: RunResult) -> None:
    numbers, of_each = double.summary(), trailer_summaries(double)
    worst = max(of_each.values(), key=lambda trailer: trailer["true_max_m"] or 0.0)
    assert isinstance(numbers["off_tracking"], dict)
    assert numbers["off_tracking"]["true_max_m"] == worst["true_max_m"]
    assert numbers["trailers"] == of_each


def test_every_trailers_signals_are_in_the_log_and_its_steering_in_the_drawings(double: RunResult) -> None:
    lead, last = double.steer_signals("lead trailer"), double.steer_signals()
    assert last == tuple(f"steer_trailer_{k}_semitrailer" for k in (1, 2, 3))
    assert lead == tuple(f"steer_trailer_{k}_lead trailer" for k in (1, 2, 3))
    for short in ("steer_trailer_1", "steer_trailer_1_command", "off_tracking_true", "off_tracking_estimate", "health"):
        np.testing.assert_array_equal(double.log[short], double.log[f"{short}_semitrailer"])
    assert np.abs(double.log[lead[2]]).max() > np.radians(10.0)
    assert np.abs(double.units[1].axle_steer(double.log)[:, 2]).max() == np.abs(double.log[lead[2]]).max()
    assert "lead trailer" in report_html(double, double.summary())


@pytest.mark.slow
def test_with_noise_free_signals_and_hardly_any_slip_the_no_slip_estimate_is_good() -> None:
    """At 5 km/h the tyres' slip is small: within 5 cm; the noise of the sensors then shows."""
    course = ("course.turn_deg=30", "course.exit=5", "course.entry=20")
    slow = ("off_tracking=kinematic", "reference_unit=false", "speed_kmh=5", *course)
    exact = run(load_scenario("roundabout", (*slow, "signals.noise=0")), 1)
    noisy = run(load_scenario("roundabout", (*slow, "signals.noise=5")), 1)
    errors = [result.summary()["off_tracking"] for result in (exact, noisy)]
    assert isinstance(errors[0], dict)
    assert isinstance(errors[1], dict)
    assert errors[0]["estimate_error_max_m"] < 0.05  # type: ignore[operator]  # a number here, as the run got that far
    assert errors[1]["estimate_error_max_m"] > 2.0 * errors[0]["estimate_error_max_m"]  # type: ignore[operator]  # too


@pytest.mark.slow
def test_steer_groups_turn_axles_by_one_angle_or_each_by_its_own() -> None:
    """Single: both steered axles alike. Common centre: the rear one turns more, both lines meet on the front's."""
    settings = ("off_tracking=truth", "reference_unit=false", "course.entry=20", "course.turn_deg=40", "course.exit=5")
    single = run(load_scenario("roundabout", (*settings, "steer_groups=single")), 1).log
    own = run(load_scenario("roundabout", (*settings, "steer_groups=common_centre")), 1).log
    np.testing.assert_allclose(single["steer_trailer_1"], single["steer_trailer_2"], atol=1e-12)
    assert np.abs(own["steer_trailer_1"] - own["steer_trailer_2"]).max() > np.radians(2.0)


def test_a_recorded_drive_is_repeated_to_its_end(tmp_path: Path) -> None:
    file = tmp_path / "drive.csv"
    file.write_text("time_s,steer_deg,speed_kmh\n0,0,9\n2,0,9\n4,6,12\n8,6,12\n", encoding="utf-8")
    settings = ("off_tracking=truth", "trailer_steering=none", f"driver.trace={file}")
    result = run(load_scenario("roundabout", settings), 1)
    assert result.outcome == "completed"
    assert result.log["time"][-1] == pytest.approx(8.0, abs=0.02)
    assert np.degrees(result.log["steer_tractor"][-1]) == pytest.approx(6.0, abs=0.1)
    assert 3.6 * result.log["v_x_tractor"][0] == pytest.approx(9.0, abs=1e-9)
    assert 3.6 * result.log["v_x_tractor"][-1] == pytest.approx(12.0, abs=0.5)


def test_the_driver_slows_down_to_the_lateral_acceleration_allowed() -> None:
    """0.5 m/s2 on the 12.5 m circle of the front corner; its tractor turns tighter: a tenth more at most."""
    course = ("course.entry=20", "course.turn_deg=60", "course.exit=5", "speed_kmh=20")
    settings = ("off_tracking=truth", "reference_unit=false", "trailer_steering=none", *course)
    log = run(load_scenario("roundabout", (*settings, "driver.max_lateral_acceleration=0.5")), 1).log
    assert np.abs(log["v_x_tractor"] * log["yaw_rate_tractor"]).max() < 0.55
    assert 3.6 * log["v_x_tractor"][0] == pytest.approx(20.0, abs=0.1)


def test_a_drivers_file_that_is_too_large_or_missing_is_named(tmp_path: Path) -> None:
    file, columns = tmp_path / "drive.csv", "time_s,steer_deg,speed_kmh\n"
    for rows, complaint in (('0,0,"' + "9" * 200_000, "131072 characters"), ("0,0,0\n" * 1_400_000, "most 4000000")):
        file.write_text(columns + rows, encoding="utf-8")
        with pytest.raises(ValueError, match=rf"drive\.csv.*{complaint}"):
            read_trace(file)
    with pytest.raises(ValueError, match=r"^driver.trace: .*none.csv: cannot be read: No such file"):
        read_trace(tmp_path / "none.csv")


# Vehicles that tow nothing: their front axle leads, their rear follows, and laws steer their own rear axles


CRANE = ("vehicle=mobile_crane_5_axle", "off_tracking=truth", "reference_unit=false")


def crane_driven(law: str, *settings: str) -> RunResult:
    return run(load_scenario("roundabout", [*CRANE, f"trailer_steering={law}", *settings]), 1)


@pytest.fixture(scope="module")
def straight() -> RunResult:
    return crane_driven("none", "course.turn_deg=270")


@pytest.fixture(scope="module")
def steered() -> RunResult:
    return crane_driven("path_preview", "course.turn_deg=270")


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
    result = crane_driven(law, "course.turn_deg=90", "course.exit=10")
    assert result.outcome == "completed"
    assert np.abs(result.log["steer_trailer_3_crane"]).max() > math.radians(8.0)


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
