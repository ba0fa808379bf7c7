"""As speed falls and friction rises the dynamic model becomes the kinematic one: no axle slides sideways."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.interpolate import interp1d

from controllers.path import Path, arc, line
from offtrack.studies.validation.no_slip_limit import kinematic_poses, poses_along, rolling_chain
from offtrack.studies.validation.simple_drives import (
    GRIP,
    along_path,
    gripping,
    on_single_axles,
    poses_of,
    round_circle,
    steered,
    tractor_and_trailer,
)
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.frames import Pose2
from vehicle.surface import Surface

LENGTH = 7.7  # hitch to axle [m]


def settled_turn(vehicle: Vehicle, speed: float, surface: Surface = GRIP) -> tuple[float, float]:
    """Speed of the hitch [m/s], and radius of the trailer's axle more than without slip [m]."""
    # The articulation fades by 1/e over 8 m; 60 m leave 1e-3 of what is still to come.
    now = round_circle(vehicle, 20.0, speed, 60.0, surface=surface)[-1]
    v_x, v_y, r = now.velocities[1]
    hitch, axle = math.hypot(v_x, v_y), math.hypot(v_x, v_y - LENGTH * r)
    return hitch, axle / r - math.sqrt((hitch / r) ** 2 - LENGTH**2)


@pytest.fixture(scope="module")
def on_truck_tyres(tractor_semitrailer: Vehicle) -> Vehicle:
    return tractor_and_trailer(tractor_semitrailer, length=LENGTH, hitch_x=0.0)


def test_slip_falls_with_the_square_of_speed(on_truck_tyres: Vehicle) -> None:
    """Side forces are mass times v^2 / R; the trailer's axle needs a slip angle in proportion, and 7.7 m of lever."""
    (fast, wide), (slow, close) = (settled_turn(on_truck_tyres, speed) for speed in (3.0, 1.5))
    assert wide / close == pytest.approx((fast / slow) ** 2, rel=0.02)  # the curve of the tyre bends at 0.05 g
    slip = fast**2 / 20.0 / GRAVITY / 4.6  # lateral acceleration in g over stiffness over load
    assert wide == pytest.approx(slip * LENGTH, rel=0.25)  # the axle runs inside of the hitch, and is heavily loaded


def test_slip_falls_as_friction_rises(on_truck_tyres: Vehicle) -> None:
    """At 0.08 g the tyres' curve is bent on snow and all but straight on the best of roads."""
    wide = [settled_turn(on_truck_tyres, 4.0, Surface(friction=mu))[1] for mu in (0.15, 0.3, 1.5)]
    assert wide[0] > 1.05 * wide[1] > 1.05 * wide[2] > 0.0


@pytest.mark.parametrize("radius", [12.5, -12.5])
def test_a_slow_turn_is_the_kinematic_one(tractor_semitrailer: Vehicle, radius: float) -> None:
    """Quarter of a circle to either side at 1 m/s on stiff tyres, every unit's pose all along."""
    vehicle = gripping(on_single_axles(tractor_semitrailer))
    front = vehicle.units[0].front_x
    path = Path(Pose2(front, 0.0, 0.0), (line(3.0), arc(0.5 * math.pi * abs(radius), 1.0 / radius), line(3.0)))
    dynamic = poses_of(along_path(vehicle, path, (front, 0.0), 1.0))
    rolling = poses_along(rolling_chain(vehicle), path, (front, 0.0))
    guided = dynamic[:, 0, :2] + front * np.column_stack([np.cos(dynamic[:, 0, 2]), np.sin(dynamic[:, 0, 2])])
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(guided, axis=0).T))])
    kinematic = interp1d(np.linspace(0.0, path.length, len(rolling)), rolling, axis=0, fill_value="extrapolate")(way)
    assert abs(dynamic[-1, 0, 2] - dynamic[-1, 1, 2]) > math.radians(20.0)  # it still follows
    assert np.hypot(*(dynamic - kinematic)[:, :, :2].reshape(-1, 2).T).max() < 0.01  # the driver's error, slip of 1e-4
    np.testing.assert_allclose(dynamic[:, :, 2], kinematic[:, :, 2], atol=2e-3)  # the same over lengths of 5 m


def test_it_agrees_with_a_published_kinematic_trailer_model(tractor_semitrailer: Vehicle) -> None:
    """commonroad-vehicle-models, kinematic single-track with an on-axle trailer: a slalom of a wave and a half."""
    vehicle = gripping(tractor_and_trailer(tractor_semitrailer, length=LENGTH, hitch_x=0.0))
    seen = steered(vehicle, lambda t: math.radians(4.0 + 16.0 * math.sin(0.3 * t)), 1.0, 30.0)
    dynamic, kinematic = poses_of(seen), kinematic_poses(vehicle, seen)
    assert np.ptp(dynamic[:, 0, 2] - dynamic[:, 1, 2]) > math.radians(25.0)  # it is a slalom
    assert np.hypot(*(dynamic - kinematic)[:, 0, :2].T).max() < 0.02  # 1e-3 rad of slip and heading over 30 m
    np.testing.assert_allclose(dynamic[:, :, 2], kinematic[:, :, 2], atol=1e-3)  # slip at 0.08 m/s2 on stiff tyres
