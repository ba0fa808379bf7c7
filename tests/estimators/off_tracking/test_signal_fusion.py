"""Fusion of camera motions with signals: outages are bridged, and wrong motions are not believed."""

import math
from collections.abc import Callable, Container, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from estimators.estimates import Anchor, Health, OffTracking
from estimators.off_tracking.buffer import BodyMotion, BufferMemory, OffTrackingBuffer
from estimators.off_tracking.signal_fusion import (
    DIRECTION,
    Correction,
    FusionMemory,
    SignalFusion,
    blended,
    extended_history,
)
from sensors.messages import CombinationSignals
from tests.estimators.towed_drive import FOLLOW, FRAME, VEHICLE, Errors, TowedDrive, towed_drive
from tests.trailers import estimate
from vehicle.frames import inverse, so3_exp, transform

BUFFER = OffTrackingBuffer(FOLLOW)
FUSION = SignalFusion(VEHICLE, 1, FOLLOW, BUFFER)
WRONG = Errors(scale=0.01, gyro=math.radians(0.2), articulation=math.radians(0.2), noise=1.0)
Memory = tuple[FusionMemory, BufferMemory]
Spoilt = Callable[[int, BodyMotion], BodyMotion | None]
Messages = Sequence[CombinationSignals]


def as_it_is(tick: int, motion: BodyMotion) -> BodyMotion:
    return motion


def all_of_them(messages: Messages) -> Messages:
    return messages


def without(dark: Container[int]) -> Spoilt:
    """No frames at these ticks."""
    return lambda tick, motion: None if tick in dark else motion


def winding(t: float) -> float:
    """Yaw rate of a tractor at 3 m/s on curves of 12 m radius, left and right [rad/s]."""
    return 0.25 * math.sin(0.35 * t)


def slipping(t: float) -> float:
    """Slip that varies slowly with the lateral acceleration and on its own [rad]."""
    return 0.006 - 0.02 * 3.0 * winding(t) + 0.003 * math.sin(0.9 * t)


@pytest.fixture(scope="module")
def drive() -> TowedDrive:
    return towed_drive(30.0, lambda t: 3.0, winding, slipping, WRONG, seed=3)


@pytest.fixture(scope="module")
def exact(drive: TowedDrive) -> dict[int, OffTracking]:
    """Off-tracking from exact motions."""
    return exact_of(drive)


def exact_of(drive: TowedDrive) -> dict[int, OffTracking]:
    memory, results = BUFFER.init(), {}
    ticks = sorted(drive.bodies)
    for since, until in pairwise(ticks):
        memory, results[until] = BUFFER.step(memory, drive.motion(since, until, std=0.0))
    return results


def run(
    drive: TowedDrive, spoilt: Spoilt = as_it_is, signals: Callable[[Messages], Messages] = all_of_them
) -> dict[int, OffTracking]:
    """Estimates of a drive; ``spoilt`` changes a frame's motion. None: no frame arrives, and the next spans the gap."""
    fusion, path, results = FUSION.init(), BUFFER.init(), {}
    good, last = 0, -1
    for tick in sorted(drive.bodies):
        motion = None
        if tick > good:
            motion = spoilt(tick, drive.motion(good, tick))
            good = tick if motion is not None else good
        arrived = tuple(signals(drive.between(last, tick)))
        last = tick
        fusion, path, estimate = FUSION.step(fusion, path, tick, motion, arrived)
        if estimate is not None:
            results[tick] = estimate
    return results


def errors(estimates: dict[int, OffTracking], exact: dict[int, OffTracking], ticks: Sequence[int]) -> np.ndarray:
    return np.array([estimates[tick].value - exact[tick].value for tick in ticks])


def filled(exact: dict[int, OffTracking]) -> list[int]:
    return [tick for tick, one in exact.items() if one.health is Health.OK]


@pytest.mark.slow
def test_as_long_as_the_camera_works_nothing_changes(drive: TowedDrive, exact: dict[int, OffTracking]) -> None:
    """The signals are a hundred times worse; to weight them would only cost."""
    estimates = run(drive)
    for tick in filled(exact):
        assert estimates[tick].value == exact[tick].value
        assert estimates[tick].health is Health.OK
        assert estimates[tick].std < 0.02  # [m]


@pytest.mark.slow
def test_wheels_that_slip_by_a_twelfth_are_no_reason_to_refuse_the_camera() -> None:
    """As braked on ice from the twelfth second on: more than any error of a sound wheel speed."""
    drive = towed_drive(18.0, lambda t: 5.0 - 0.2 * max(0.0, t - 12.0), lambda t: 0.0, seed=4)

    def braked(messages: Messages) -> Messages:
        slips = [0.08 * min(max(0.0, 1e-3 * one.tick - 12.0), 1.0) for one in messages]
        return [replace(one, speed=one.speed * (1.0 - slip)) for one, slip in zip(messages, slips, strict=True)]

    estimates, exact = run(drive, signals=braked), exact_of(drive)
    for tick in filled(exact):
        assert estimates[tick].value == exact[tick].value
        assert estimates[tick].bridged == 0.0


@pytest.mark.slow
def test_locked_wheels_of_a_vehicle_that_turns_are_no_reason_to_refuse_the_camera() -> None:
    """At walking pace on ice, where wheels that read 0 seem to stand; no steering makes a truck turn on the spot."""
    drive = towed_drive(20.0, lambda t: max(0.8, 3.0 - 0.4 * max(0.0, t - 8.0)), lambda t: 0.1, errors=WRONG, seed=4)

    def locked(messages: Messages) -> Messages:
        return [replace(one, speed=0.0) if one.tick > 16_000 else one for one in messages]

    estimates, exact = run(drive, signals=locked), exact_of(drive)
    for tick in filled(exact):
        assert estimates[tick].value == pytest.approx(exact[tick].value, abs=1e-3)  # [m]
        assert estimates[tick].bridged == 0.0


@pytest.mark.slow
def test_outages_of_two_seconds_are_bridged_within_the_stated_uncertainty(
    drive: TowedDrive, exact: dict[int, OffTracking]
) -> None:
    """Gyro off by 0.2 deg/s and speed by 1 %: unlearnt, 0.1 m of yaw and 0.06 m along the path in two seconds."""
    ends, ratios, returned = [], [], []
    for first in (8000, 11_000):
        begins = range(first, 26_000, 6000)
        dark = {tick for begin in begins for tick in range(begin + FRAME, begin + 2001, FRAME)}
        estimates = run(drive, without(dark))
        assert all(estimates[tick].health is Health.DEGRADED for tick in dark)
        for begin in begins:
            end = begin + 2000
            ends += list(errors(estimates, exact, [end]))
            returned += list(errors(estimates, exact, [end + FRAME * k for k in (11, 20, 30)]))
            back = np.diff(errors(estimates, exact, range(end, end + 1500, FRAME)))
            assert np.abs(back).max() < 0.01  # [m] without a step; the error at the end is up to three times as large
        ratios += list(errors(estimates, exact, sorted(dark)) / [estimates[tick].std for tick in sorted(dark)])
    assert np.sqrt(np.mean(np.square(ends))) < 0.03  # [m] dead reckoning that learns nothing has 0.042 on roundabouts
    assert np.mean(np.abs(ratios) < 2.5) > 0.95
    assert np.max(np.abs(returned)) < 0.01  # [m] the path within the gap is corrected as well


@pytest.mark.slow
def test_without_a_camera_it_goes_on_for_ever(drive: TowedDrive, exact: dict[int, OffTracking]) -> None:
    """Degraded, never lost, with a standard deviation that grows and then stays."""
    estimates = run(drive, without(range(100_000)))
    ticks = [tick for tick in filled(exact) if tick > 20_000]
    stds = np.array([estimates[tick].std for tick in ticks])
    assert all(estimates[tick].health is Health.DEGRADED for tick in ticks)
    assert np.all(np.abs(errors(estimates, exact, ticks)) < 2.5 * stds)
    assert np.all((stds > 0.03) & (stds < 0.3))  # [m]


@pytest.mark.slow
@pytest.mark.parametrize(
    "wrong",
    [
        pytest.param(transform(np.eye(3), np.array([0.0, 0.05, 0.0])), id="5 cm to the side"),
        pytest.param(transform(so3_exp(np.array([0.0, 0.0, 0.01])), np.zeros(3)), id="turned by 0.6 deg"),
        pytest.param(transform(np.eye(3), np.array([-0.3, 0.0, 0.0])), id="standing"),
    ],
)
def test_confident_motions_that_contradict_the_signals_are_not_believed(
    drive: TowedDrive, exact: dict[int, OffTracking], wrong: np.ndarray
) -> None:
    """For a second, each stated to a millimetre, as of a vehicle mistaken for the world."""

    def spoilt(tick: int, motion: BodyMotion) -> BodyMotion:
        return replace(motion, X_PC=motion.X_PC @ wrong) if 20_000 < tick <= 21_000 else motion

    estimates = run(drive, spoilt)
    ticks = [tick for tick in filled(exact) if tick > 20_000]
    ratios = errors(estimates, exact, ticks) / [estimates[tick].std for tick in ticks]
    assert np.abs(ratios).max() < 2.5
    assert all(estimates[tick].health is Health.DEGRADED for tick in range(20_100, 21_001, FRAME))
    assert np.abs(errors(estimates, exact, ticks)).max() < 0.15  # [m]; believed, it would be 0.5 m and more


@pytest.mark.slow
def test_a_camera_that_is_wrong_for_long_is_never_called_good(drive: TowedDrive, exact: dict[int, OffTracking]) -> None:
    """Distances 10 % too long throughout: as of a camera that is turned."""

    def spoilt(tick: int, motion: BodyMotion) -> BodyMotion:
        X_PC = motion.X_PC.copy()
        X_PC[:3, 3] *= 1.1
        return replace(motion, X_PC=X_PC)

    estimates = run(drive, spoilt)
    ticks = [tick for tick in filled(exact) if tick > 10_000]
    assert all(estimates[tick].health is Health.DEGRADED for tick in ticks)
    assert np.all(np.abs(errors(estimates, exact, ticks)) < 2.5 * np.array([estimates[tick].std for tick in ticks]))


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [2.0, -5.0, 10.0])
def test_a_camera_that_is_turned_is_doubted_by_its_angle(
    drive: TowedDrive, exact: dict[int, OffTracking], degrees: float
) -> None:
    """About the vertical: the axles of both units contradict its direction of travel alike."""
    turned = transform(so3_exp(np.array([0.0, 0.0, math.radians(degrees)])), np.zeros(3))

    def spoilt(tick: int, motion: BodyMotion) -> BodyMotion:
        return replace(motion, X_PC=turned @ motion.X_PC @ inverse(turned)) if tick > 16_000 else motion

    estimates = run(drive, spoilt)
    ticks = [tick for tick in filled(exact) if tick > 16_000]
    assert not any(estimates[tick].doubts for tick in filled(exact) if tick < 16_000)
    assert min(tick for tick in ticks if estimates[tick].health is not Health.OK) <= (
        20_000 if degrees == 2.0 else 16_400
    )
    doubted = [tick for tick in ticks if DIRECTION in estimates[tick].doubts]
    assert len(doubted) > 0.5 * len(ticks)
    ratios = errors(estimates, exact, doubted) / [estimates[tick].std for tick in doubted]
    assert np.abs(ratios).max() < 2.5


def test_a_keyframe_from_before_the_outage_corrects_the_bridge(
    drive: TowedDrive, exact: dict[int, OffTracking]
) -> None:
    """The odometry goes on from a frame of the outage, and measures the frames after it from its old keyframe."""
    fusion, path = FUSION.init(), BUFFER.init()
    estimates: dict[int, OffTracking] = {}
    begin, end = 20_000, 21_500
    for tick in sorted(drive.bodies)[1:260]:
        motion: BodyMotion | None = drive.motion(tick - FRAME, tick)
        if begin < tick <= end:
            motion = None
        elif tick > end and motion is not None:
            anchored = drive.motion(begin, tick)
            motion = replace(motion, anchor=Anchor(tick=begin, X_AC=anchored.X_PC, covariance=anchored.covariance))
        fusion, path, estimate = FUSION.step(fusion, path, tick, motion, drive.between(tick - FRAME, tick))
        if estimate is not None:
            estimates[tick] = estimate
    late = [tick for tick in estimates if tick > end + 1000]  # the correction is made within a second
    assert np.abs(errors(estimates, exact, late)).max() < 0.005  # [m]
    assert max(estimates[tick].std for tick in late) < 0.02  # [m]


@pytest.mark.slow
def test_a_motion_from_within_an_outage_goes_on_at_a_crawl() -> None:
    """Samples a centimetre apart are thinned out, but not the one that the motion starts from."""
    drive = towed_drive(16.0, lambda t: 3.0 if t < 10.0 else 0.1, lambda t: 0.0, errors=WRONG, seed=3)
    fusion, path, last = FUSION.init(), BUFFER.init(), None
    for tick in sorted(drive.bodies)[1:]:
        motion = None if 13_000 < tick <= 14_000 else drive.motion(tick - FRAME, tick)
        fusion, path, last = FUSION.step(fusion, path, tick, motion, drive.between(tick - FRAME, tick))
        assert tick < 8000 or (last is not None and last.health is not Health.LOST)


@pytest.mark.slow
def test_an_outage_is_bridged_with_a_speed_that_is_stuck() -> None:
    """It is found a second after it began to repeat itself, within the outage; what was bridged is reckoned again."""
    drive = towed_drive(24.0, lambda t: 3.0 + 0.6 * math.sin(0.5 * t), winding, slipping, WRONG, seed=3)
    exact, dark = exact_of(drive), range(19_100, 21_001)

    def stuck(messages: Messages) -> Messages:
        return [replace(one, speed=2.7) if one.tick > 19_000 else one for one in messages]

    estimates = run(drive, without(dark), stuck)
    late = [tick for tick in dark if tick % FRAME == 0 and tick > 20_100]
    assert all(estimates[tick].doubts == ("wheel speed",) for tick in late)
    assert np.all(np.abs(errors(estimates, exact, late)) < 2.5 * np.array([estimates[tick].std for tick in late]))
    assert np.abs(errors(estimates, exact, late)).max() < 0.15  # [m]


@pytest.mark.slow
def test_a_delayed_frame_is_brought_up_to_date(drive: TowedDrive, exact: dict[int, OffTracking]) -> None:
    """Frames arrive three captures late; the estimate is that of now."""
    fusion, path = FUSION.init(), BUFFER.init()
    late: list[float] = []
    for tick in sorted(drive.bodies)[:300]:
        motion = drive.motion(tick - 4 * FRAME, tick - 3 * FRAME) if tick >= 4 * FRAME else None
        fusion, path, estimate = FUSION.step(fusion, path, tick, motion, drive.between(tick - FRAME, tick))
        assert estimate is None or estimate.tick == tick
        if estimate is not None and tick in filled(exact):
            late.append(estimate.value - exact[tick].value)
            assert abs(late[-1]) < 2.5 * estimate.std
    assert np.sqrt(np.mean(np.square(late))) < 0.015  # [m] dead reckoning of 0.3 s


@pytest.mark.slow
def test_without_signals_an_outage_is_bridged_at_the_last_velocity(drive: TowedDrive) -> None:
    """As without fusion: lost at once, and a new path after a second; no frozen signals are trusted either."""
    frozen: list[CombinationSignals] = []

    def freezing(messages: Messages) -> Messages:
        out = []
        for message in messages:
            if message.tick > 19_000:
                frozen.append(frozen[-1] if frozen else message)
                out.append(replace(frozen[0], tick=message.tick))
            else:
                out.append(message)
        return out

    def gone(messages: Messages) -> Messages:
        return [message for message in messages if message.tick <= 19_000]

    for signals in (freezing, gone):
        estimates = run(drive, without(range(20_100, 20_501)), signals)
        assert all(estimates[tick].health is Health.LOST for tick in range(20_100, 20_501, FRAME))
        assert all(estimates[tick].health is Health.OK for tick in range(20_600, 30_000, FRAME))


def test_signals_without_noise_are_not_frozen() -> None:
    """On a straight at constant speed they repeat themselves exactly; an outage is bridged all the same."""
    straight = towed_drive(12.0, lambda t: 3.0 + 0.5 * math.sin(t) * (t < 6.0), lambda t: 0.0)
    estimates = run(straight, without(range(8000, 10_001)))
    assert all(estimates[tick].health is Health.DEGRADED for tick in range(8000, 10_001, FRAME))
    assert estimates[10_000].value == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("level", [4.0, 10.0])
def test_noisy_signals_do_not_discredit_the_camera(exact: dict[int, OffTracking], level: float) -> None:
    """Their noise is measured, and constant errors are expected to be as much larger."""
    angle = math.radians(0.1 * level)
    errors_of_signals = Errors(scale=0.005 * level, gyro=angle, articulation=angle, noise=level)
    noisy = towed_drive(16.0, lambda t: 3.0, winding, slipping, errors_of_signals, seed=6)
    estimates = run(noisy)
    ticks = [tick for tick in estimates if exact[tick].health is Health.OK]
    assert np.abs(errors(estimates, exact, ticks)).max() < 0.01  # [m]


def test_a_stuck_gyro_does_not_discredit_the_camera(drive: TowedDrive, exact: dict[int, OffTracking]) -> None:
    """The articulation contradicts it as soon as the trailer turns; the camera is then used alone."""
    ticks = [tick for tick in filled(exact) if tick > 18_000]

    def stuck(messages: Messages) -> Messages:
        return [
            replace(message, yaw_rates=np.array([message.yaw_rates[0], 0.2])) if message.tick > 17_000 else message
            for message in messages
        ]

    estimates = run(drive, signals=stuck)
    assert np.abs(errors(estimates, exact, ticks)).max() < 0.4  # [m] noticed after 2 deg; believed, it would be metres
    assert all(estimates[tick].health is Health.OK for tick in ticks[-40:])


@pytest.mark.parametrize("offsets", [(0.0, 5.0), (5.0, 0.0)], ids=["gyro", "hitch angle"])
def test_what_was_bridged_by_a_signal_at_fault_is_reckoned_again(
    drive: TowedDrive, exact: dict[int, OffTracking], offsets: tuple[float, float]
) -> None:
    """Camera and a signal fail at the same time: the bridge goes on without that signal, from its beginning."""
    angle, rate = np.radians(offsets)

    def shifted(messages: Messages) -> Messages:
        return [
            replace(one, articulation=one.articulation + angle, yaw_rates=one.yaw_rates + np.array([0.0, rate]))
            if one.tick > 17_000
            else one
            for one in messages
        ]

    estimates = run(drive, without(range(17_100, 20_001)), shifted)
    after = range(17_600, 20_001, FRAME)  # 14 m behind the hitch the fault alone is worth 1.2 m/s or 0.35 m/s
    assert all(estimates[tick].bridged > 0.0 for tick in after)
    off = errors(estimates, exact, after)
    assert np.abs(off).max() < 0.15  # [m]
    assert np.all(np.abs(off) < 3.0 * np.array([estimates[tick].std for tick in after]))


@pytest.mark.parametrize("value", [None, 0.0])
def test_a_stuck_wheel_speed_does_not_discredit_the_camera(value: float | None) -> None:
    """A speed that repeats itself for a second is not used, whether it stays where it was or falls to zero."""
    braking = towed_drive(28.0, lambda t: 3.0 + 1.5 * math.sin(0.5 * t), winding, slipping, WRONG, seed=8)
    exact = exact_of(braking)
    last = next(message.speed for message in braking.signals if message.tick > 17_000) if value is None else value

    def stuck(messages: Messages) -> Messages:
        return [replace(message, speed=last) if message.tick > 17_000 else message for message in messages]

    estimates = run(braking, signals=stuck)
    ticks = [tick for tick in filled(exact) if tick > 18_200]  # a second to notice it
    assert np.abs(errors(estimates, exact, ticks)).max() < 0.4  # [m]; believed, it would be metres
    assert all(estimates[tick].health is Health.OK for tick in ticks[-10:])


@pytest.mark.slow
def test_standing_through_an_outage_keeps_the_path() -> None:
    """Nineteen seconds in the dark at traffic lights: no drift, however wrong the gyros are."""

    def speed(t: float) -> float:
        return min(3.0, max(0.0, 10.0 - t)) if t < 40.0 else min(3.0, t - 40.0)

    drive = towed_drive(50.0, speed, lambda t: 0.1 * speed(t), errors=WRONG, seed=4)
    estimates = run(drive, without(range(15_001, 34_001)))
    assert estimates[15_000].value == pytest.approx(estimates[34_000].value, abs=1e-9)
    assert estimates[34_000].std < 0.05  # [m]
    assert estimates[34_100].health is Health.OK


@pytest.mark.slow
def test_reversing_through_an_outage_keeps_the_path_behind() -> None:
    """Six metres back in the dark: the path ahead is removed, and the rest is still known to centimetres."""
    drive = towed_drive(
        34.0, lambda t: 3.0 * math.tanh(24.0 - t), lambda t: 0.1 * math.tanh(24.0 - t), errors=WRONG, seed=5
    )
    exact_memory, memory_results = BUFFER.init(), {}
    ticks = sorted(drive.bodies)
    for since, until in pairwise(ticks):
        exact_memory, memory_results[until] = BUFFER.step(exact_memory, drive.motion(since, until, std=0.0))
    estimates = run(drive, without(range(25_001, 27_001)))
    during = range(25_100, 27_001, FRAME)
    assert np.abs(errors(estimates, memory_results, during)).max() < 0.05  # [m]
    assert all(estimates[tick].health is Health.DEGRADED for tick in during)


def test_signals_that_are_no_numbers_or_late_are_left_out() -> None:
    """Of four that arrive one has a value that is none, one is older than the newest, and one repeats it."""
    known = np.array([[0.0, 1.0, 2.0], [10.0, 1.1, 2.1]])
    arrived = np.array([[20.0, np.nan, 2.2], [5.0, 1.2, 2.2], [25.0, 1.1, 2.1], [30.0, 1.3, 2.3]])
    assert extended_history(known, list(arrived), 0, 30)[:, 0].tolist() == [0.0, 10.0, 30.0]


def test_a_correction_that_is_held_back_bends_the_path_to_the_value() -> None:
    """At the follow point the path lies at the value; at the hitch it stays, and at a half of the time half is left."""
    before = estimate(1000, value=0.5, path=np.column_stack([-np.arange(16.0), np.full(16, 0.5)]))
    held = blended(before, Correction(1000, 0.2), 14.0)
    assert (held.value, held.path[0, 1]) == pytest.approx((0.7, 0.5))
    assert held.path[14] == pytest.approx([-14.0, held.value])
    assert held.path_tangent == pytest.approx(-math.atan(0.2 / 14.0))
    assert held.std == pytest.approx(math.hypot(before.std, 0.2))
