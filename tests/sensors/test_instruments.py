"""Instruments: what they say of a known motion, how wrong they are, and frames and signals as one sensor."""

import math
from dataclasses import dataclass

import numpy as np
import pytest

from sensors.instruments.combination import CombinationSensors, TrailerViewSensor
from sensors.instruments.navigation import PERIOD, ReferenceUnit
from sensors.messages import CombinationSignals, GnssIns, StereoFrame, TrailerView, stereo_frame
from tests.trailers import signals as readings
from tests.trailers import truth as truth_at
from vehicle.clock import Schedule
from vehicle.combination.description import load_vehicle
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, rotation_zyx, transform

VEHICLE = load_vehicle("uk_longer_semitrailer")
WHEELBASE = VEHICLE.units[0].steered_axles[0].x


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
    once, twice = sensors(1.0).sample(truth(0)), sensors(2.0).sample(truth(0))
    assert twice.speed - 5.0 == pytest.approx(2.0 * (once.speed - 5.0), abs=1e-12)
    assert twice.yaw_rates - truth(0).velocities[:, 2] == pytest.approx(
        2.0 * (once.yaw_rates - truth(0).velocities[:, 2]), abs=1e-12
    )


# Frames and signals as one sensor: each at its own rate, and faults of the one do not touch the other


DARK = np.zeros((2, 2), dtype=np.uint8)


@dataclass(frozen=True)
class Moment:
    tick: int


class Camera:
    """Every third frame is lost."""

    def sample(self, truth: Moment) -> StereoFrame | None:
        return None if truth.tick % 300 == 0 else StereoFrame(tick=truth.tick, left=DARK, right=DARK)


class Signals:
    def sample(self, truth: Moment) -> CombinationSignals | None:
        return readings(truth.tick, angles=np.zeros(0), speed=1.0)


def views(latency: int, until: int) -> list[TrailerView]:
    frames, readings = Schedule(period=100, latency=latency), Schedule(period=20, latency=20)
    sensor = TrailerViewSensor(Camera(), frames, Signals(), readings)
    assert (sensor.schedule.period, sensor.schedule.latency) == (20, latency)
    sent = [sensor.sample(Moment(tick)) for tick in range(0, until + 1, sensor.schedule.period)]
    return [view for view in sent if view is not None]


def test_a_view_comes_with_every_due_frame_also_with_a_lost_one() -> None:
    """An estimator cannot bridge an outage that nobody tells it of."""
    sent = views(latency=100, until=1000)
    assert [view.tick for view in sent] == list(range(0, 1001, 100))
    assert [view.frame is None for view in sent] == [tick % 300 == 0 for tick in range(0, 1001, 100)]
    assert stereo_frame(sent[0]) is None
    frame = stereo_frame(sent[1])
    assert frame is not None
    assert frame.tick == 100
    assert stereo_frame(frame) is frame


def test_every_signal_is_sent_once_and_in_order() -> None:
    """Up to the frame's own capture: later ones are not there yet when the view is put together."""
    ticks = [message.tick for view in views(latency=100, until=1000) for message in view.signals]
    assert ticks == list(range(0, 1001, 20))


def test_signals_that_have_not_arrived_are_sent_with_the_next_view() -> None:
    """Frames without latency are older than the signals of the same moment when these arrive."""
    sent = views(latency=0, until=200)
    assert [view.signals[-1].tick for view in sent if view.signals] == [80, 180]
    assert sent[0].signals == ()


# The GNSS-aided inertial unit: where it sits, how large its errors are and how fast they change


P_BU = np.array([-7.0, 0.8, 1.2])
UNITS = 1500


def towed(tick: int = 0) -> Truth:
    """A trailer that rolls, climbs and turns left at 0.3 rad/s."""
    R, p = rotation_zyx(2.0, -0.05, 0.04), np.array([3.0, -2.0, 0.1])
    poses, velocities = np.array([[0.0, 0.0, 0.0], [3.0, -2.0, 2.0]]), np.array([[3.0, 0.0, 0.2], [2.5, 0.4, 0.3]])
    return truth_at(tick, poses=poses, velocities=velocities, bodies=np.stack([np.eye(4), transform(R, p)]))


def unit(seed: int) -> ReferenceUnit:
    return ReferenceUnit(unit=1, p_BU=P_BU, rng=np.random.default_rng(seed))


@pytest.fixture(scope="module")
def first_messages() -> list[GnssIns]:
    return [unit(seed).sample(towed()) for seed in range(UNITS)]


def test_on_average_it_says_where_it_is_and_how_it_moves(first_messages: list[GnssIns]) -> None:
    """Position and velocity are those of the instrument, not of the trailer's origin: lever arm and yaw rate enter."""
    X_WB = towed().bodies[1]
    at = np.mean([message.p_WU for message in first_messages], axis=0)
    np.testing.assert_allclose(at, X_WB[:3, 3] + X_WB[:3, :3] @ P_BU, atol=5 * 0.021 / math.sqrt(UNITS))  # 5 sigma
    v_B = np.array([2.5 - 0.3 * 0.8, 0.4 + 0.3 * -7.0, 0.0])
    v = np.mean([message.v_WU for message in first_messages], axis=0)
    np.testing.assert_allclose(v, X_WB[:3, :3] @ v_B, atol=5 * 0.0139 / math.sqrt(UNITS))
    angles = np.mean([(m.heading, m.pitch, m.roll) for m in first_messages], axis=0)
    np.testing.assert_allclose(angles, [2.0, -0.05, 0.04], atol=5 * math.radians(0.06) / math.sqrt(UNITS))


def test_position_is_good_to_20_mm_in_the_plane(first_messages: list[GnssIns]) -> None:
    """The quoted accuracy, and a heading of the order of 0.1 deg; an RMS of 1500 samples is known to 3 %, 2 sigma."""
    p_WU = towed().bodies[1] @ [*P_BU, 1.0]
    errors = np.array([message.p_WU - p_WU[:3] for message in first_messages])
    assert math.sqrt((errors[:, :2] ** 2).sum(axis=1).mean()) == pytest.approx(0.020, rel=0.06)
    assert errors[:, 2].std() == pytest.approx(1.5 * 0.01413, rel=0.06)  # heights are half as good again
    assert 0.05 < math.degrees(np.std([message.heading for message in first_messages])) < 0.1


def autocorrelation(errors: FloatArray, lag: int) -> float:
    return float(np.mean(errors[:-lag] * errors[lag:]) / np.mean(errors**2))


def test_errors_change_over_seconds_not_from_message_to_message() -> None:
    """A unit filters inertially: 10 ms later the error is nearly the same, after minutes another one altogether."""
    where = towed().bodies[1] @ [*P_BU, 1.0]

    def errors(period: int, number: int) -> FloatArray:
        sensor = unit(1)
        return np.array([sensor.sample(towed(period * k)).p_WU[0] - where[0] for k in range(number)])

    assert autocorrelation(errors(PERIOD, 3000), 1) > 0.99
    series = errors(10 * PERIOD, 6000)  # ten minutes: the slow part alone gives some twenty independent samples
    assert 0.5 < autocorrelation(series, 30) < 0.95  # 3 s: the fast fifth of the variance is gone, the slow one not
    assert abs(autocorrelation(series, 1500)) < 0.5  # 150 s, 2 sigma of what twenty samples can tell


def test_how_often_it_is_asked_does_not_change_the_size_of_its_errors() -> None:
    """Gauss-Markov errors are stationary at any spacing: after one hour-long pause they are as large as ever."""
    where = towed().bodies[1] @ [*P_BU, 1.0]
    late = []
    for seed in range(600):
        sensor = unit(seed)
        sensor.sample(towed())
        late.append(sensor.sample(towed(3_600_000)).p_WU[0] - where[0])
    assert np.std(late) == pytest.approx(0.01413, rel=0.12)  # 4 sigma of 600 samples
