"""Dead reckoning of a trailer against closed forms, finite differences and drawn noise."""

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from estimators.off_tracking import dead_reckoning
from estimators.off_tracking.dead_reckoning import DeadReckoning, Parameters, Reckoned
from sensors.messages import CombinationSignals
from tests.estimators.towed_drive import FRONT, HITCH, SIGNAL, VEHICLE, Errors, towed_drive
from tests.trailers import signals as readings
from vehicle.combination.description import load_vehicle
from vehicle.frames import FloatArray, Pose2, planar

RECKONING = DeadReckoning(VEHICLE, 1)
COUNT = len(RECKONING.prior().mean)
NONE = Parameters(np.zeros(COUNT), np.zeros((COUNT, COUNT)))  # exact signals, no slip, and certain of it


def history(signals: Iterable[CombinationSignals], reckoning: DeadReckoning = RECKONING) -> FloatArray:
    return np.array([reckoning.row(message) for message in signals])


def reckoned(signals: tuple[CombinationSignals, ...], since: int, until: int, parameters: Parameters) -> Reckoned:
    result = RECKONING.reckoned(history(signals), since, until, parameters)
    assert result is not None
    return result


def pose(X: FloatArray) -> FloatArray:
    moved = planar(X)
    return np.array([moved.psi, moved.x, moved.y])


def steady(speed: float, yaw_rate: float, articulation: float, seconds: float = 4.0) -> tuple[CombinationSignals, ...]:
    """Signals of a combination on a circle, whose front wheels do not slip."""
    steer = math.atan(yaw_rate * FRONT / speed) if speed else 0.0
    return tuple(
        readings(tick, speed=speed, steer=steer, articulation=np.array([articulation]), yaw_rates=np.full(2, yaw_rate))
        for tick in range(0, round(1000 * seconds) + 1, SIGNAL)
    )


@pytest.mark.parametrize("speed", [5.0, -5.0])
def test_circle_has_the_chord_of_its_arc(speed: float) -> None:
    """The hitch has the velocity (v, r x_h) of the tractor, turned by the articulation; its chord is 2 R sin(a / 2)."""
    rate, gamma = 0.3, 0.4
    moved = reckoned(steady(speed, rate, gamma), 500, 3500, NONE).pose
    angle = rate * 3.0
    travel = math.hypot(speed, rate * HITCH)
    chord = travel / rate * 2.0 * math.sin(0.5 * angle)
    direction = math.atan2(rate * HITCH, speed) + gamma + 0.5 * angle
    expected = [angle, chord * math.cos(direction), chord * math.sin(direction)]
    np.testing.assert_allclose(moved, expected, atol=1e-4 * chord)  # trapezoidal rule: (r dt)^2 / 12 = 3e-6


def test_a_bank_pushes_the_trailer_down_as_its_tyres_slip() -> None:
    """Straight ahead at 3 m/s on 5 %: after two seconds on the bank the slip is that of 0.05 g, less 6 % of caution.

    Without the accelerometer the path would be 9 mm in a metre too high.
    """
    level = steady(3.0, 0.0, 0.0, 6.0)
    banked = tuple(replace(message, lateral_acceleration=1.07 * 9.81 * 0.05) for message in level)
    certain = Parameters(RECKONING.prior().mean, NONE.covariance)
    _, x, y = reckoned(banked, 4000, 5000, certain).pose - [0.0, 0.0, reckoned(level, 4000, 5000, certain).pose[2]]
    assert y / x == pytest.approx(-0.0196 * 9.81 * 0.05 / (1.0 + (3.0 / 12.0) ** 2), rel=0.02)


def test_a_slip_that_varies_leads_astray_as_its_integral_does() -> None:
    """Straight ahead over 14 m: sigma^2 2 l^2 (u - 1 + e^-u), u = 14 m / l, for a slip that is correlated over l.

    A random walk that is never drawn back would make 80 mm instead of 59 mm; white noise adds 3 mm.
    """
    prior = RECKONING.prior()
    variance = np.zeros(COUNT)
    variance[2] = prior.covariance[2, 2]
    moved = reckoned(steady(5.0, 0.0, 0.0), 500, 3300, Parameters(prior.mean, np.diag(variance)))
    length = dead_reckoning._SLIP.distance
    u = 14.0 / length
    expected = variance[2] * 2.0 * length**2 * (u - 1.0 + math.exp(-u))
    assert moved.covariance[2, 2] == pytest.approx(expected, rel=0.03)


def test_ends_between_two_signals_are_interpolated() -> None:
    """Frames need not coincide with signals: two halves make a whole."""
    drive = towed_drive(4.0, lambda t: 3.0 + t, lambda t: 0.2 * t)
    whole = reckoned(drive.signals, 1000, 2000, NONE).pose
    first, second = reckoned(drive.signals, 1000, 1490, NONE), reckoned(drive.signals, 1490, 2000, NONE)
    chained = Pose2(*first.pose[[1, 2, 0]]) @ Pose2(*second.pose[[1, 2, 0]])
    np.testing.assert_allclose([chained.psi, chained.x, chained.y], whole, atol=2e-4)


@pytest.mark.parametrize("name", ["uk_longer_semitrailer", "b_double_steered"])
def test_derivatives_are_those_of_finite_differences(name: str) -> None:
    """The covariance with the parameters, P J^T, against the pose with each parameter changed."""
    vehicle = load_vehicle(name)
    unit = len(vehicle.units) - 1
    reckoning = DeadReckoning(vehicle, unit)
    rng = np.random.default_rng(1)
    signals = tuple(
        replace(
            message,
            articulation=0.1 * rng.standard_normal(unit),
            yaw_rates=0.2 + 0.1 * rng.standard_normal(unit + 1),
            angles=0.1 * rng.standard_normal(2),
        )
        for message in steady(4.0, 0.2, 0.0, 1.0)
    )
    prior = reckoning.prior()
    base = reckoning.reckoned(history(signals, reckoning), 0, 1000, prior)
    assert base is not None
    certain = Parameters(prior.mean, np.zeros_like(prior.covariance))
    walked = np.diag(reckoning.forgotten(certain, 4.0, 1.0).covariance) > 1e-3 * np.diag(prior.covariance)
    for k in np.flatnonzero(~walked):
        step = 1e-4 * math.sqrt(prior.covariance[k, k])
        mean = prior.mean.copy()
        mean[k] += step
        moved = reckoning.reckoned(history(signals, reckoning), 0, 1000, Parameters(mean, prior.covariance))
        assert moved is not None
        expected = (moved.pose - base.pose) / step * prior.covariance[k, k]
        # the trapezoidal rule differs from the sums of the derivatives by (r dt)^2 / 12, and noise makes r large
        np.testing.assert_allclose(base.cross[k], expected, atol=0.005 * np.abs(expected).max())


@pytest.mark.slow
def test_white_noise_has_the_spread_of_drawn_signals() -> None:
    """Certain parameters, noise alone: of 150 drawn stretches of 2 s a standard deviation is known to 6 %."""

    def driven(noise: float, seed: int) -> Reckoned:
        drive = towed_drive(2.0, lambda t: 3.0, lambda t: 0.2, errors=Errors(noise=noise), seed=seed)
        return reckoned(drive.signals, 0, 2000, NONE)

    exact, drawn = driven(0.0, 0), [driven(1.0, k) for k in range(150)]
    errors = np.array([one.pose - exact.pose for one in drawn])
    yaw = math.radians(0.1) * 0.02 * math.sqrt(99.5)  # 99.5 samples of 20 ms, their errors independent
    assert errors[:, 0].std() == pytest.approx(yaw, rel=0.2)
    assert math.sqrt(exact.covariance[0, 0]) == pytest.approx(yaw, rel=0.1)  # and a little of the bias that wanders
    stated = np.sqrt(np.diag(exact.covariance))
    assert np.all(errors.std(axis=0) < 1.2 * stated)  # which includes the slip that wanders


def test_parameters_are_forgotten_down_to_their_prior() -> None:
    """A Gauss-Markov process: after a long way without measurements the prior is all that is known.

    A large slip may change by as much, and is forgotten down to its own size.
    """
    prior = RECKONING.prior()
    known = Parameters(prior.mean + 0.001, 0.01 * prior.covariance)
    after = RECKONING.forgotten(known, 1e9, 1e9)
    np.testing.assert_allclose(after.mean, prior.mean)
    np.testing.assert_allclose(after.covariance, prior.covariance)
    sliding = prior.mean.copy()
    sliding[dead_reckoning._VARYING] = 0.1
    spread = RECKONING.forgotten(Parameters(sliding, prior.covariance), 1e9, 1e9).covariance[2, 2]
    assert spread == pytest.approx(0.1**2)
    unchanged = RECKONING.forgotten(known, 0.0, 0.0)
    np.testing.assert_allclose(unchanged.covariance, known.covariance)


def test_standstill_is_no_motion_whatever_the_gyros_say() -> None:
    """Their biases would turn a standing trailer by 0.1 deg in a second."""
    standing = tuple(replace(message, yaw_rates=np.full(2, 0.002)) for message in steady(0.0, 0.0, 0.1, 10.0))
    moved = reckoned(standing, 0, 10_000, RECKONING.prior())
    assert np.all(moved.pose == 0.0)
    assert moved.distance == 0.0
    assert 0.0 < math.sqrt(moved.covariance[1, 1]) < 0.05  # [m] creep stays possible


def test_missing_signals_end_it() -> None:
    """A third of a second between signals is interpolated, more is not; behind the newest one hardly anything."""
    signals = steady(5.0, 0.1, 0.0)
    short = tuple(message for message in signals if not 1000 < message.tick < 1300)
    assert RECKONING.reckoned(history(short), 500, 2000, NONE) is not None
    long = tuple(message for message in signals if not 1000 < message.tick < 1400)
    assert RECKONING.reckoned(history(long), 500, 2000, NONE) is None
    assert RECKONING.reckoned(history(signals), 3500, 4040, NONE) is not None  # two signals late
    assert RECKONING.reckoned(history(signals), 3500, 4100, NONE) is None
    assert RECKONING.reckoned(RECKONING.no_history(), 0, 100, NONE) is None


def test_a_tractor_or_a_unit_that_is_not_there_is_refused() -> None:
    """Only towed units have a hitch."""
    for unit in (0, 2):
        with pytest.raises(ValueError, match=f"unit = {unit} must be a towed unit of uk_longer_semitrailer, 1 to 1"):
            DeadReckoning(VEHICLE, unit)
