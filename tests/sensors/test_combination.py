"""The combination's own sensors: what they say of a known motion, and how wrong they are."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sensors.instruments.combination import CombinationSensors
from tests.trailers import truth as truth_at
from vehicle.combination.description import load_vehicle
from vehicle.combination.truth import Truth
from vehicle.frames import rotation_zyx, transform

VEHICLE = load_vehicle("uk_longer_semitrailer")
WHEELBASE = VEHICLE.units[0].steered_axles[0].x
GROUP = -9.31  # middle of the trailer's axles [m]


def truth(tick: int, *, v_y: float = 0.0, roll: float = 0.0, steer: float = 0.2) -> Truth:
    """A tractor rolling without slip at 5 m/s, its trailer turning at 0.1 rad/s."""
    yaw_rate = 5.0 * math.tan(steer) / WHEELBASE
    body = transform(rotation_zyx(0.0, 0.0, roll), np.zeros(3))
    return truth_at(
        tick,
        poses=np.array([[0.0, 0.0, 0.3], [0.0, 0.0, 0.1]]),
        velocities=np.array([[5.0, 0.0, yaw_rate], [4.9, v_y, 0.1]]),
        bodies=np.array([np.eye(4), body]),
        steer=np.array([steer, 0.01, 0.02]),
    )


def sensors(noise: float, seed: int = 1) -> CombinationSensors:
    return CombinationSensors(VEHICLE, 1, rng=np.random.default_rng(seed), noise=noise)


def test_without_noise_they_say_what_is_so() -> None:
    """The front wheels roll along their own heading; without slip that is the rear axle's speed over cos(steer)."""
    said = sensors(0.0).sample(truth(0))
    assert said.speed == pytest.approx(5.0, abs=1e-12)
    assert said.steer == 0.2
    assert said.articulation == pytest.approx([0.2], abs=1e-12)
    np.testing.assert_array_equal(said.yaw_rates, truth(0).velocities[:, 2])
    np.testing.assert_array_equal(said.angles, [0.01, 0.02])


def test_the_accelerometer_feels_turning_sliding_and_gravity() -> None:
    """a_y = dv_y/dt + v_x r on the body, and g sin(roll) where the body's left side is up."""
    sensor = sensors(0.0)
    sensor.sample(truth(0))
    said = sensor.sample(truth(20, v_y=0.01, roll=0.05))
    assert said.lateral_acceleration == pytest.approx(0.5 + 4.9 * 0.1 + 9.81 * math.sin(0.05), abs=1e-9)


def test_everybody_hears_the_same_message() -> None:
    """A second look at the same tick draws no new noise: law and estimator share one set of sensors."""
    sensor = sensors(1.0)
    assert sensor.sample(truth(0)) is sensor.sample(truth(0))


def test_errors_are_those_of_the_data_sheet() -> None:
    """Articulation 0.15 deg rms about a bias that stays; 2000 samples know a deviation to 1.6 %, three of them: 5 %."""
    sensor = sensors(1.0)
    read = np.array([float(sensor.sample(truth(20 * k)).articulation[0]) for k in range(2000)]) - 0.2
    assert np.std(read) == pytest.approx(math.radians(0.15), rel=0.05)
    biases = [float(sensors(1.0, seed).sample(truth(0)).articulation[0]) - 0.2 for seed in range(400)]
    assert np.std(biases) == pytest.approx(math.radians(math.hypot(0.1, 0.15)), rel=0.11)  # 400: 3.5 %


def test_the_noise_scale_scales_all_errors() -> None:
    """The same stream with twice the scale is twice as wrong, in every reading."""
    once, twice = sensors(1.0).sample(truth(0)), sensors(2.0).sample(truth(0))
    assert twice.speed - 5.0 == pytest.approx(2.0 * (once.speed - 5.0), abs=1e-12)
    assert twice.yaw_rates - truth(0).velocities[:, 2] == pytest.approx(
        2.0 * (once.yaw_rates - truth(0).velocities[:, 2]), abs=1e-12
    )
