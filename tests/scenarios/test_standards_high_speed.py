"""Steady circle, sine with dwell and pseudo-random steer against linear theory and closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from offtrack.studies.standards.proving_ground import Conditions
from offtrack.studies.standards.random_steer import PEAK, amplification_response, random_steer, steer_cycle
from offtrack.studies.standards.random_steer import SPEED as RANDOM_SPEED
from offtrack.studies.standards.steady_circle import set_speed, steady_circle
from offtrack.studies.standards.yaw_stability import DWELL, END, FREQUENCY, START, sine_with_dwell, steer_for, wave
from vehicle.combination.description import GRAVITY, load_vehicle
from vehicle.combination.handling import rearward_amplification, understeer_gradient


@pytest.mark.parametrize("name", ["eu_tractor_semitrailer", "rigid_truck"])
def test_the_steady_circle_has_the_understeer_gradient_of_linear_theory(name: str) -> None:
    """Linear theory is the limit of small accelerations; over 0.04 to 0.1 g load transfer costs a little stiffness.

    The gradient there lies between theory's and the one at 0.2 g, where tyres saturate more.
    """
    vehicle = load_vehicle(name)
    done = steady_circle(vehicle, "none")
    assert done.outcome == "completed"
    theory = math.degrees(understeer_gradient(vehicle, 8.0)) * GRAVITY
    small, large = (done.figures[f"understeer_gradient{at}_deg_per_g"] for at in ("", "_at_0_2_g"))
    assert theory < small < large
    assert small == pytest.approx(theory, abs=0.4)  # [deg/g]


def test_the_circle_robot_keeps_the_radius_and_the_acceleration() -> None:
    """The tractor's yaw rate is speed over radius within 1 %: integral control lags behind a rising demand."""
    vehicle = load_vehicle("eu_tractor_semitrailer")
    done = steady_circle(vehicle, "none", Conditions(hand="right", radius=150.0))
    log = done.log
    late = log["time"] > 30.0
    radius = log["v_x_tractor"][late] / log["yaw_rate_tractor"][late]
    np.testing.assert_allclose(radius, -150.0, rtol=0.01)
    assert set_speed(1e3, 150.0) ** 2 / 150.0 == pytest.approx(0.25 * GRAVITY)
    # Ackermann's angle, and the understeer of about 4 deg/g
    assert done.figures["circle_steer_deg"] == pytest.approx(math.degrees(3.8 / 150.0) + 0.2 * 4.9, abs=0.25)


def test_a_circle_that_friction_does_not_allow_is_not_measured() -> None:
    """0.1 of friction is 0.1 g; no figure is made up for 0.2 g."""
    done = steady_circle(load_vehicle("rigid_truck"), "none", Conditions(friction=0.1))
    assert done.outcome == "did not reach 0.22 g"
    assert all(math.isnan(value) for value in done.figures.values())


def test_the_sine_with_dwell_has_its_shape() -> None:
    """A quarter before the end it is at the far peak and stays there for the dwell; its ends are zero."""
    time = np.linspace(0.0, 6.0, 6001)
    values = wave(time)
    assert not values[time <= START].any()
    assert not values[time >= END].any()
    held = (time > START + 0.75 / FREQUENCY) & (time < START + 0.75 / FREQUENCY + DWELL)
    np.testing.assert_allclose(values[held], -1.0)
    assert values.max() == pytest.approx(1.0)
    assert np.abs(np.diff(values)).max() < 0.004  # it does not jump: 2 pi 0.5 Hz 1 ms is 0.0031


def test_the_amplitude_of_the_sine_with_dwell_is_a_steady_fifth_of_g() -> None:
    """L / R + K a_y for a_y = 0.2 g at 72 km/h: theory's gain and gradient belong together."""
    vehicle = load_vehicle("eu_tractor_semitrailer")
    acceleration, speed = 0.2 * GRAVITY, 20.0
    by_gradient = 3.8 * acceleration / speed**2 + understeer_gradient(vehicle, speed) * acceleration
    # the tridem's scrub lengthens the wheelbase a little
    assert steer_for(vehicle, acceleration, speed) == pytest.approx(by_gradient, rel=0.05)


def test_after_a_sine_with_dwell_a_stable_truck_stops_yawing() -> None:
    """A rigid truck's yaw is well damped; all load transfer and displacement are those of a lane change."""
    figures = sine_with_dwell(load_vehicle("rigid_truck"), "none").figures
    assert figures["dwell_yaw_rate_ratio_1_5_s"] < 0.05 < 1.0
    assert figures["dwell_yaw_rate_ratio_0_75_s"] >= figures["dwell_yaw_rate_ratio_1_5_s"]
    assert figures["dwell_amplification_yaw"] == pytest.approx(1.0)
    assert 0.5 < figures["dwell_displacement_m"] < 2.0


def test_the_random_steer_excites_what_it_says() -> None:
    """Lines from 0.1 to 1.5 Hz with equal amplitudes, none elsewhere; it repeats every 40 s."""
    steer = steer_cycle(load_vehicle("eu_tractor_semitrailer"), RANDOM_SPEED, 0.8)
    spectrum = np.abs(np.fft.rfft(steer))
    f = np.fft.rfftfreq(len(steer), 40.0 / len(steer))
    inside = (f > 0.09) & (f < 1.51)
    assert spectrum[inside].min() == pytest.approx(spectrum[inside].max())
    assert spectrum[~inside].max() < 1e-9 * spectrum.max()


@pytest.mark.parametrize("name", ["eu_tractor_semitrailer", "rigid_truck", "a_double"])
def test_the_frequency_response_of_amplification_is_linear_theorys(name: str) -> None:
    """Small accelerations, theory with the same lags of tyres and roll: within 3 % at every frequency that matters."""
    vehicle = load_vehicle(name)
    done = random_steer(vehicle, "none")
    assert done.outcome == "completed"
    assert done.figures["random_theory_difference"] < 0.03
    response = amplification_response(vehicle, done.log, RANDOM_SPEED, 0.8)
    assert done.figures["random_amplification"] == pytest.approx(response.theory.max(), rel=0.03)
    unit = vehicle.units[0].name
    lateral = done.log[f"v_x_{unit}"] * done.log[f"yaw_rate_{unit}"]
    assert np.abs(lateral).max() < 2.0 * PEAK  # it is a small motion indeed
    if name == "a_double":  # the comparison can fail: theory without lags of tyres is farther away
        without = rearward_amplification(vehicle, RANDOM_SPEED, response.frequency)
        strong = response.measured > 0.5 * response.measured.max()
        assert np.max(np.abs(response.measured / without - 1.0)[strong]) > 0.03
