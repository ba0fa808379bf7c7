"""The preview driver in closed loop with whole combinations: stable at any speed, and on the path."""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest

from controllers.driver import PreviewDriver
from offtrack.studies.standards.proving_ground import drive, point_path
from offtrack.studies.validation.driver_checks import driver_modes, with_damping
from scenarios.assembly.adapters import tractor_guided_at
from scenarios.assembly.trailer_run import assemble
from scenarios.courses import corner
from scenarios.loop.trailer_session import TrailerSession
from scenarios.options.scenario import load_scenario
from scenarios.results.trailer_signals import TrailerRow
from tests.vehicle.chains import with_axles
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle
from vehicle.combination.variants import changed_vehicle
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface
from vehicle.tyres.laws import TYRES


def growth(vehicle: Vehicle, driven: Vehicle, kmh: float) -> float:
    return float(driver_modes(vehicle, driven, kmh / 3.6, vehicle.units[0].front_x).real.max())


@pytest.mark.parametrize(("stiffness", "mass"), [(0.6, 1.0), (1.6, 1.0), (1.0, 1.15)])
def test_a_wrong_data_sheet_does_not_destabilise(stiffness: float, mass: float) -> None:
    """Tyres of other makes and other loads differ by as much."""
    vehicle = load_vehicle("eu_tractor_semitrailer")
    driven = with_damping(changed_vehicle(vehicle, {"cornering_stiffness_scale": stiffness, "mass_scale": mass}), 0.0)
    assert max(growth(vehicle, driven, kmh) for kmh in (2.5, 10.0, 90.0)) < 0.0


@pytest.mark.parametrize("wheelbase", [2.5, 7.0])
def test_other_wheelbases_are_stable_without_tuning(wheelbase: float) -> None:
    truck = load_vehicle("rigid_truck")
    unit = truck.units[0]
    scale = wheelbase / unit.axles[0].x
    front = unit.axles[0].model_copy(update={"x": wheelbase})
    inertia = {"yaw_inertia": unit.yaw_inertia * scale**2, "cg_x": unit.cg_x * scale}
    short = unit.model_copy(update={"axles": (front, *unit.axles[1:]), **inertia, "front_x": wheelbase + 1.4})
    vehicle = with_damping(truck.model_copy(update={"units": (short,)}), 0.0)
    assert max(growth(vehicle, vehicle, kmh) for kmh in (1.0, 2.5, 10.0, 50.0, 110.0)) < 0.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "kmh", "lateral", "friction"),
    [
        ("brush", 60.0, 0.2, 0.8),
        ("brush", 90.0, 0.15, 0.3),
        ("magic_formula", 20.0, 0.2, 0.8),
        ("linear", 2.5, 0.0, 0.8),
    ],
)
def test_curves_are_driven_without_weaving_on_any_tyre(law: str, kmh: float, lateral: float, friction: float) -> None:
    """Undamped tyres of other laws, half of the friction used, a quarter turn at creep.

    A kink of the path costs millimetres; after it the steer only settles.
    """
    vehicle, speed = with_tyres(load_vehicle("eu_tractor_semitrailer"), law), kmh / 3.6
    x = vehicle.units[0].steered_axles[0].x
    radius = speed**2 / (lateral * GRAVITY) if lateral else 12.5
    turn = min(math.tau, 6.0 * speed / radius) if lateral else 0.25 * math.tau
    course = corner(wheel_x=x, radius=radius, turn=turn, entry=20.0, exit=5.0 * speed + 10.0)
    end = course.path.pose(course.length)
    log = drive(
        vehicle,
        Surface(friction=friction),
        PreviewDriver(tractor_guided_at(vehicle, course.reference), course.path, speed),
        trailer_steering="none",
        speed=speed,
        done=lambda truth: math.dist((Pose2(*truth.poses[0]) @ Pose2(x, 0.0, 0.0))[:2], end[:2]) < 1.0,
        patience=1.3 * course.length / speed,
    ).log
    station, offsets = 0.0, []
    for at_x, at_y in point_path(log, vehicle.units[0].name, x).tolist():
        station = course.path.project(at_x, at_y, station)
        offsets.append(math.dist((at_x, at_y), course.path.pose(station)[:2]))
    assert max(offsets) < 0.02
    last = log["steer_tractor"][log["time"] > log["time"][-1] - 1.5]
    assert np.abs(np.diff(last)).sum() - abs(last[-1] - last[0]) < math.radians(0.1)


def with_tyres(vehicle: Vehicle, law: str) -> Vehicle:
    """Undamped tyres of another law with the stiffness of the vehicle's own."""
    changes = []
    for own in (axle.tyre for unit in vehicle.units for axle in unit.axles):
        kept = ("nominal_load", "relaxation_length", "pneumatic_trail", "rolling_resistance")
        numbers = {name: getattr(own, name) for name in kept} | {"damping": 0.0, "load_sensitivity": 0.1}
        along, across = (float(stiffness) for stiffness in own.nominal_stiffness)
        numbers |= {"longitudinal_stiffness": along, "cornering_stiffness": across}
        shape = {"shape": 1.3, "curvature": -1.0} if law == "magic_formula" else {}
        changes.append({"tyre": TYRES[law].model_validate({"model": law, **numbers, **shape})})
    return with_axles(vehicle, *changes)


# Standstills and ways back: the trailer keeps to its own way, its axles locked meanwhile


WITHOUT_CAMERAS = ["off_tracking=truth", "reference_unit=false"]
SHORT = [*WITHOUT_CAMERAS, "course.entry=22", "driver.stops=[{station=45.0, wait=1.0, back=15.0}]"]


def ridden(name: str, settings: list[str]) -> TrailerSession:
    session = TrailerSession(assemble(load_scenario(name, settings), 101))
    while session.outcome is None:
        session.advance()
    session.close()
    return session


def poses(rows: Sequence[TrailerRow], unit: int) -> FloatArray:
    return np.array([row.truth.poses[unit] for row in rows])


def beside(way: FloatArray, points: FloatArray) -> FloatArray:
    """Distance of points (n, 2) from a polyline (m, 2) [m]."""
    found = np.full(len(points), np.inf)
    for a, b in pairwise(way[::20]):
        along = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a) + 1e-12), 0.0, 1.0)
        found = np.minimum(found, np.hypot(*(points - a - along[:, None] * (b - a)).T))
    return found


@pytest.fixture(scope="module")
def shunted() -> TrailerSession:
    """The shunt on a shorter course, steered from the true off-tracking."""
    return ridden("reversing", SHORT)


@pytest.mark.slow
def test_a_shunt_is_driven_to_its_end(shunted: TrailerSession) -> None:
    """15 m back along the trailer's own way, at walking pace, and on to the course's end."""
    v = np.array([row.truth.velocities[0, 0] for row in shunted.rows])
    assert shunted.outcome == "completed"
    assert 0.01 * -v[v < 0.0].sum() == pytest.approx(15.0, abs=3.0)  # the tractor's way is the longer one in a bend
    assert v.min() > -1.6
    assert {row.record.driver.gear for row in shunted.rows} == {1.0, -1.0}


def test_backwards_the_trailer_keeps_to_the_way_that_it_came(shunted: TrailerSession) -> None:
    """Its wheels were steered on the way there and are straight on the way back: it swings by half a metre at first."""
    rows, v = shunted.rows, np.array([row.truth.velocities[0, 0] for row in shunted.rows])
    back = v < -0.3
    S = poses(rows, 1)
    axle = S[:, :2] - 9.43 * np.column_stack([np.cos(S[:, 2]), np.sin(S[:, 2])])
    first = int(np.argmax(back))
    apart = beside(axle[:first], axle[back])
    assert apart.max() < 0.8
    assert apart[-50:].max() < 0.15
    assert np.abs(poses(rows, 0)[:, 2] - S[:, 2]).max() < math.radians(45.0)


def test_steered_axles_are_straight_backwards_and_steer_again_forwards(shunted: TrailerSession) -> None:
    rows, v = shunted.rows, np.array([row.truth.velocities[0, 0] for row in shunted.rows])
    angles = np.array([row.truth.steer[1:] for row in rows])
    back = np.flatnonzero(v < -0.3)
    settled = back[len(back) // 3 :]  # 20 deg/s take a second from the angles of the bend
    assert np.abs(angles[settled]).max() < math.radians(0.1)
    assert np.abs(angles[back[-1] :]).max() > math.radians(2.0)
    assert np.abs(np.diff(angles, axis=0)).max() < 0.01 * math.radians(20.5)  # never faster than the actuators


@pytest.mark.slow
def test_standstills_leave_path_preview_as_it_was() -> None:
    """A stop of four seconds in the turn: neither the axles nor the off-tracking do anything while it stands."""
    stops = "driver.stops=[{station=40.0, wait=4.0}]"
    session = ridden("stop-and-go", [*WITHOUT_CAMERAS, "course.turn_deg=120", "course.exit=10", stops])
    v = np.array([row.truth.velocities[0, 0] for row in session.rows])
    standing = np.flatnonzero(np.abs(v) < 0.03)
    angles = np.array([row.truth.steer[1:] for row in session.rows])[standing[100:]]
    assert session.outcome == "completed"
    assert len(standing) >= 350
    assert np.ptp(angles, axis=0).max() < math.radians(0.3)
    assert np.abs(angles).max() > math.radians(1.0)  # in the turn they are steered
