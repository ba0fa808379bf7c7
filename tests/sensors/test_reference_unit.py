"""The GNSS-aided inertial unit: where it sits, how large its errors are and how fast they change."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sensors.instruments.navigation import PERIOD, ReferenceUnit
from sensors.messages import GnssIns
from tests.trailers import truth as truth_at
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, rotation_zyx, transform

P_BU = np.array([-7.0, 0.8, 1.2])
UNITS = 1500


def truth(tick: int = 0) -> Truth:
    """A trailer that rolls, climbs and turns left at 0.3 rad/s."""
    R, p = rotation_zyx(2.0, -0.05, 0.04), np.array([3.0, -2.0, 0.1])
    poses, velocities = np.array([[0.0, 0.0, 0.0], [3.0, -2.0, 2.0]]), np.array([[3.0, 0.0, 0.2], [2.5, 0.4, 0.3]])
    return truth_at(tick, poses=poses, velocities=velocities, bodies=np.stack([np.eye(4), transform(R, p)]))


def unit(seed: int) -> ReferenceUnit:
    return ReferenceUnit(unit=1, p_BU=P_BU, rng=np.random.default_rng(seed))


@pytest.fixture(scope="module")
def first_messages() -> list[GnssIns]:
    return [unit(seed).sample(truth()) for seed in range(UNITS)]


def test_on_average_it_says_where_it_is_and_how_it_moves(first_messages: list[GnssIns]) -> None:
    """Position and velocity are those of the instrument, not of the trailer's origin: lever arm and yaw rate enter."""
    X_WB = truth().bodies[1]
    at = np.mean([message.p_WU for message in first_messages], axis=0)
    np.testing.assert_allclose(at, X_WB[:3, 3] + X_WB[:3, :3] @ P_BU, atol=5 * 0.021 / math.sqrt(UNITS))  # 5 sigma
    v_B = np.array([2.5 - 0.3 * 0.8, 0.4 + 0.3 * -7.0, 0.0])
    v = np.mean([message.v_WU for message in first_messages], axis=0)
    np.testing.assert_allclose(v, X_WB[:3, :3] @ v_B, atol=5 * 0.0139 / math.sqrt(UNITS))
    angles = np.mean([(m.heading, m.pitch, m.roll) for m in first_messages], axis=0)
    np.testing.assert_allclose(angles, [2.0, -0.05, 0.04], atol=5 * math.radians(0.06) / math.sqrt(UNITS))


def test_position_is_good_to_20_mm_in_the_plane(first_messages: list[GnssIns]) -> None:
    """The quoted accuracy, and a heading of the order of 0.1 deg; an RMS of 1500 samples is known to 3 %, 2 sigma."""
    p_WU = truth().bodies[1] @ [*P_BU, 1.0]
    errors = np.array([message.p_WU - p_WU[:3] for message in first_messages])
    assert math.sqrt((errors[:, :2] ** 2).sum(axis=1).mean()) == pytest.approx(0.020, rel=0.06)
    assert errors[:, 2].std() == pytest.approx(1.5 * 0.01413, rel=0.06)  # heights are half as good again
    assert 0.05 < math.degrees(np.std([message.heading for message in first_messages])) < 0.1


def autocorrelation(errors: FloatArray, lag: int) -> float:
    return float(np.mean(errors[:-lag] * errors[lag:]) / np.mean(errors**2))


def test_errors_change_over_seconds_not_from_message_to_message() -> None:
    """A unit filters inertially: 10 ms later the error is nearly the same, after minutes another one altogether."""
    where = truth().bodies[1] @ [*P_BU, 1.0]

    def errors(period: int, number: int) -> FloatArray:
        sensor = unit(1)
        return np.array([sensor.sample(truth(period * k)).p_WU[0] - where[0] for k in range(number)])

    assert autocorrelation(errors(PERIOD, 3000), 1) > 0.99
    series = errors(10 * PERIOD, 6000)  # ten minutes: the slow part alone gives some twenty independent samples
    assert 0.5 < autocorrelation(series, 30) < 0.95  # 3 s: the fast fifth of the variance is gone, the slow one not
    assert abs(autocorrelation(series, 1500)) < 0.5  # 150 s, 2 sigma of what twenty samples can tell


def test_how_often_it_is_asked_does_not_change_the_size_of_its_errors() -> None:
    """Gauss-Markov errors are stationary at any spacing: after one hour-long pause they are as large as ever."""
    where = truth().bodies[1] @ [*P_BU, 1.0]
    late = []
    for seed in range(600):
        sensor = unit(seed)
        sensor.sample(truth())
        late.append(sensor.sample(truth(3_600_000)).p_WU[0] - where[0])
    assert np.std(late) == pytest.approx(0.01413, rel=0.12)  # 4 sigma of 600 samples
