"""Faults: their effect on messages, their time, and the sensors that they apply to."""

import importlib
import math
from collections.abc import Callable
from dataclasses import astuple, dataclass
from typing import ClassVar

import cv2
import numpy as np
import pytest

from sensors.camera.rig import CameraModel, StereoRig, mount_rotation
from sensors.faults.fault import FAULTS, Fault, FaultContext, FaultKind, Pinhole, T, checked_kind, defaults, with_faults
from sensors.faults.image_kinds import ImageFault
from sensors.faults.message_kinds import AnySensorFault
from sensors.instruments.navigation import ExactPose
from sensors.messages import (
    BodyPose,
    CombinationSignals,
    GreyImage,
    Message,
    RoverView,
    Sensor,
    SlipReading,
    Stamped,
    StereoFrame,
    message_type,
)
from tests.trailers import signals as readings
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray
from vehicle.option import Option

TruthOf = Callable[..., Truth]
PERIOD = 100  # [ticks]
CALIBRATION = StereoRig(
    facing="rear", width=672, height=240, hfov=math.radians(100.0), x=-13.6, y=0.0, z=3.0, baseline=0.5
).calibration()
UNIT = 1  # of a tractor and its trailer


def kind_named(name: str) -> type[FaultKind]:
    module, _, kind = FAULTS[name].partition(":")
    return checked_kind(name, getattr(importlib.import_module(module), kind))


KINDS = {name: kind_named(name) for name in FAULTS}


def kinds_for(message: type[Message], *, but: type[Message] | None = None) -> list[str]:
    """Kinds that apply to such messages, but not to others: a new kind of the catalogue is tested with its like."""
    return [n for n, kind in KINDS.items() if kind.applies_to(message) and not (but and kind.applies_to(but))]


MESSAGE_KINDS = kinds_for(BodyPose)
IMAGE_KINDS = kinds_for(RoverView, but=BodyPose)
STEREO_KINDS = kinds_for(StereoFrame, but=RoverView)
SIGNAL_KINDS = kinds_for(CombinationSignals, but=BodyPose)


def fault(name: str, amount: tuple[float, ...] = (), *, start: float = 0.0, duration: float | None = None) -> Fault:
    return Fault(name=name, kind=KINDS[name], amount=amount, start=start, duration=duration)


def scene() -> GreyImage:
    white = np.random.default_rng(1).uniform(0.0, 255.0, (CALIBRATION.height, CALIBRATION.width))
    smooth = cv2.GaussianBlur(white, (0, 0), 6.0)
    return np.asarray(cv2.normalize(smooth, np.empty_like(smooth), 0, 255, cv2.NORM_MINMAX), dtype=np.uint8)


SCENE = scene()


class Counting:
    """Stereo cameras whose images are shifted by one column per centimetre driven."""

    def sample(self, truth: Truth) -> StereoFrame:
        column = round(float(truth.bodies[0, 0, 3]) * 100.0)
        left = np.roll(SCENE, column, axis=1)
        return StereoFrame(tick=truth.tick, left=left, right=left, colour=np.zeros((*SCENE.shape, 3), dtype=np.uint8))


@dataclass(frozen=True)
class Time:
    tick: int


class CountingRover:
    """A rover's camera and instruments; the scene moves one column per tick."""

    def sample(self, truth: Time) -> RoverView:
        return RoverView(
            tick=truth.tick,
            image=np.roll(SCENE, truth.tick, axis=1),
            heading=0.001 * truth.tick,
            wheel_speeds=np.zeros(4),
            steer=np.zeros(4),
            colour=np.zeros((*SCENE.shape, 3), dtype=np.uint8),
        )


@dataclass(frozen=True, kw_only=True)
class Echo:
    tick: int
    distance: float


class Sonar:
    """A user's own sensor; it hears nothing at odd captures."""

    def sample(self, truth: Stamped) -> Echo | None:
        return Echo(tick=truth.tick, distance=0.1 * truth.tick) if truth.tick // PERIOD % 2 == 0 else None


def at(k: int) -> FloatArray:
    """Two metres a second along x."""
    X = np.eye(4)
    X[0, 3] = 0.2 * k
    return X


def generators(seed: int) -> Callable[[int], np.random.Generator]:
    return lambda k: np.random.default_rng((seed, k))


def stereo(*faults: Fault, seed: int = 0) -> Sensor[Truth, StereoFrame]:
    return with_faults(Counting(), faults, camera=CALIBRATION, unit=0, rng=generators(seed))


def on_rover(*faults: Fault, camera: Pinhole | None = CALIBRATION) -> Sensor[Time, RoverView]:
    return with_faults(CountingRover(), faults, camera=camera, unit=0, rng=generators(0))


def on_reference_unit(*faults: Fault) -> Sensor[Truth, BodyPose]:
    return with_faults(ExactPose(0, 0.0), faults, camera=None, unit=0, rng=generators(0))


def sent(truth_of: TruthOf, fault: Fault, captures: int, *, seed: int = 0) -> list[StereoFrame | None]:
    sensor = stereo(fault, seed=seed)
    return [sensor.sample(truth_of(PERIOD * k, at(k))) for k in range(captures)]


def ticks(messages: list[StereoFrame | None]) -> list[int | None]:
    return [None if message is None else message.tick for message in messages]


def image(message: StereoFrame | None) -> GreyImage:
    assert message is not None
    return message.left


@pytest.mark.parametrize("kind", [*MESSAGE_KINDS, *STEREO_KINDS, *IMAGE_KINDS])
def test_no_fault_does_anything_outside_its_time(truth_of: TruthOf, kind: str) -> None:
    """From 0.5 s for 0.3 s: captures before and after it are those of a sound sensor."""
    messages = sent(truth_of, fault(kind, start=0.5, duration=0.3), 12)
    sound = sent(truth_of, fault("dropout", (0.0,)), 12)
    for k in (*range(5), *range(8, 12)):
        got, expected = messages[k], sound[k]
        assert got is not None
        assert expected is not None
        assert got.tick == expected.tick
        assert np.array_equal(got.left, expected.left)
        assert np.array_equal(got.right, expected.right)


def test_dropout_loses_its_share(truth_of: TruthOf) -> None:
    """Of 500 messages a fifth, give or take four standard deviations; the same ones with the same seed."""
    losing = fault("dropout", (0.2,))
    lost = [message is None for message in sent(truth_of, losing, 500)]
    assert sum(lost) == pytest.approx(100, abs=4.0 * math.sqrt(500 * 0.2 * 0.8))
    assert lost == [message is None for message in sent(truth_of, losing, 500)]
    assert lost != [message is None for message in sent(truth_of, losing, 500, seed=1)]


def test_a_frozen_sensor_repeats_its_last_message_under_new_times(truth_of: TruthOf) -> None:
    messages = sent(truth_of, fault("freeze", start=0.3, duration=0.2), 6)
    assert ticks(messages) == [0, 100, 200, 300, 400, 500]
    same = [np.array_equal(image(messages[2]), image(message)) for message in messages]
    assert same == [False, False, True, True, True, False]


def test_duplicates_repeat_the_message_before(truth_of: TruthOf) -> None:
    messages = sent(truth_of, fault("duplicate", (0.2,)), 200)
    twice = sum(np.array_equal(image(a), image(b)) for a, b in zip(messages[1:], messages[:-1], strict=True))
    assert twice == pytest.approx(40, abs=4.0 * math.sqrt(200 * 0.2 * 0.8))  # four standard deviations
    assert ticks(messages) == [PERIOD * k for k in range(200)]


def test_delayed_messages_keep_the_time_of_their_capture(truth_of: TruthOf) -> None:
    """Two captures late from 0.3 s on: two gaps, then old messages with their old stamps."""
    messages = sent(truth_of, fault("delay", (2.0,), start=0.3), 8)
    assert ticks(messages) == [0, 100, 200, None, None, 300, 400, 500]


def test_a_late_right_camera_sees_where_the_body_will_be(truth_of: TruthOf) -> None:
    """50 ms at 2 m/s: 10 cm, ten columns of these images; the left camera is on time."""
    last = sent(truth_of, fault("desync", (0.05,), start=0.3), 6)[-1]
    assert last is not None
    assert last.tick == 500
    assert np.array_equal(last.left, np.roll(SCENE, 100, axis=1))
    assert np.array_equal(last.right, np.roll(SCENE, 110, axis=1))


def test_a_knocked_camera_can_be_set_right_by_the_papers_homography(truth_of: TruthOf) -> None:
    """Only the right image turns, by the given angles."""
    angles = (-0.5, 0.4, 0.2)
    (message,) = sent(truth_of, fault("decalibration", angles), 1)
    assert message is not None
    c = CALIBRATION
    K = np.array([[c.focal_length, 0.0, c.cx], [0.0, c.focal_length, c.cy], [0.0, 0.0, 1.0]])
    H = K @ mount_rotation(*np.radians(angles)) @ np.linalg.inv(K)
    back = cv2.warpPerspective(message.right, H, (c.width, c.height)).astype(float)
    assert np.array_equal(message.left, SCENE)
    assert np.abs(back - SCENE)[10:-10, 10:-10].mean() < 1.0  # [grey levels] of interpolating twice
    assert np.abs(message.right.astype(float) - SCENE)[10:-10, 10:-10].mean() > 5.0


@pytest.mark.parametrize("kind", [name for name, kind in KINDS.items() if issubclass(kind, ImageFault)])
def test_faulty_images_come_without_the_colour_picture(truth_of: TruthOf, kind: str) -> None:
    (message,) = sent(truth_of, fault(kind), 1)
    assert message is not None
    assert message.colour is None


def test_blackout_glare_and_dirt(truth_of: TruthOf) -> None:
    """Nothing at all; more light everywhere and white somewhere; a share of each lens in the dark."""
    (black,), (veiled,), (dirty,) = (sent(truth_of, fault(kind), 1) for kind in ("blackout", "glare", "dirt"))
    assert not image(black).any()
    assert (image(veiled) >= SCENE).all()
    assert (image(veiled) == 255).sum() > (SCENE == 255).sum() + 500
    assert (image(dirty).astype(float) < 0.75 * SCENE).mean() == pytest.approx(0.3, abs=0.08)  # soft edges, dark spots


def test_gain_changes_the_right_image_alone(truth_of: TruthOf) -> None:
    """Scaled and shifted to the nearest grey level, cut off at black and white."""
    (message,) = sent(truth_of, fault("gain", (1.5, -40.0)), 1)
    assert isinstance(message, StereoFrame)
    assert np.array_equal(message.left, SCENE)
    expected = np.clip(np.round(1.5 * message.left.astype(float) - 40.0), 0, 255)  # this scene is equal in both images
    assert np.abs(message.right - expected).max() <= 0.5


def test_faults_add_up(truth_of: TruthOf) -> None:
    both = stereo(fault("freeze", start=0.2), fault("dropout", (1.0,), start=0.4))
    messages = [both.sample(truth_of(PERIOD * k, at(k))) for k in range(6)]
    assert ticks(messages) == [0, 100, 200, 300, None, None]
    assert np.array_equal(image(messages[3]), image(messages[1]))
    late = stereo(fault("delay"), fault("dropout", (0.3,)))
    for k in range(20):  # the outer fault does not stamp old messages anew
        message = late.sample(truth_of(PERIOD * k, at(k)))
        assert message is None or message.tick == PERIOD * (k - 1)


@pytest.mark.parametrize("kind", MESSAGE_KINDS)
def test_a_users_own_sensor_can_fail(kind: str) -> None:
    """Any dataclass with a tick is a message; captures without one stay without one, or repeat an old one."""
    faulty = with_faults(Sonar(), [fault(kind)], camera=None, unit=0, rng=generators(0))
    messages = [faulty.sample(Time(PERIOD * k)) for k in range(60)]
    sound = [Sonar().sample(Time(PERIOD * k)) for k in range(60)]
    assert any(isinstance(message, Echo) for message in messages)
    assert messages != sound


@pytest.mark.parametrize("kind", [*MESSAGE_KINDS, *IMAGE_KINDS])
def test_a_rovers_camera_can_fail(kind: str) -> None:
    """Faults of transmission and of single images apply to its view; the compass stays as it is in the latter case."""
    camera = CameraModel(width=672, height=240, fx=280.0, fy=282.0, cx=335.5, cy=119.5)
    faulty = on_rover(fault(kind), camera=camera)
    views = [faulty.sample(Time(PERIOD * k)) for k in range(60)]
    sound = [CountingRover().sample(Time(PERIOD * k)) for k in range(60)]
    pairs = [(a, b) for a, b in zip(views, sound, strict=True) if a is not None]
    assert len(pairs) >= 40
    assert len(pairs) < 60 or any(not np.array_equal(a.image, b.image) for a, b in pairs)
    if kind in IMAGE_KINDS:
        assert [a.heading for a, _ in pairs] == [b.heading for _, b in pairs]


@pytest.mark.parametrize(
    ("kinds", "made", "words"),
    [
        (STEREO_KINDS, on_rover, "stereo camera; the sensor of this run sends RoverView"),
        ([*STEREO_KINDS, *IMAGE_KINDS], on_reference_unit, "(stereo )?camera; .* sends BodyPose"),
        (SIGNAL_KINDS, stereo, "combination's own sensors; .* sends StereoFrame"),
    ],
)
def test_faults_are_refused_for_sensors_that_cannot_have_them(
    kinds: list[str], made: Callable[[Fault], object], words: str
) -> None:
    for kind in kinds:
        with pytest.raises(ValueError, match=f"^faults: {kind} needs a {words}$"):
            made(fault(kind))


class CountingSignals:
    """A combination's own sensors; the hitch angle grows by 0.1 rad every half second."""

    def sample(self, truth: Time) -> CombinationSignals:
        return readings(
            truth.tick,
            angles=np.zeros(1),
            speed=5.0,
            articulation=np.array([0.2e-3 * truth.tick]),
            yaw_rates=np.array([0.2, 0.3]),
        )


def sound_and_faulty(name: str, amount: tuple[float, ...] = ()) -> tuple[list[CombinationSignals], ...]:
    """Signals at 0, 0.5, … 2.5 s, sound and with a fault that is active at 1 s and 1.5 s."""
    faults = [fault(name, amount, start=1.0, duration=1.0)]
    faulty = with_faults(CountingSignals(), faults, camera=None, unit=UNIT, rng=generators(0))
    times = [Time(500 * k) for k in range(6)]
    samples = [[sensor.sample(time) for time in times] for sensor in (CountingSignals(), faulty)]
    return tuple([one for one in of_one if one is not None] for of_one in samples)


@pytest.mark.parametrize("kind", SIGNAL_KINDS)
def test_a_fault_of_signals_acts_in_its_time(kind: str) -> None:
    sound, faulty = ([astuple(signals) for signals in of_one] for of_one in sound_and_faulty(kind))
    same = [all(map(np.array_equal, one, other)) for one, other in zip(sound, faulty, strict=True)]
    assert same[:2] == same[4:] == [True, True]
    assert not all(same[2:4])


@pytest.mark.parametrize(
    ("name", "amount", "read", "expected"),
    [
        ("articulation_offset", (9.0,), lambda s: s.articulation[0], [0.2 + math.radians(9), 0.3 + math.radians(9)]),
        ("articulation_stuck", (), lambda s: s.articulation[0], [0.1, 0.1]),
        ("gyro_bias", (-3.0,), lambda s: s.yaw_rates[1], [0.3 - math.radians(3)] * 2),
        ("gyro_drift", (2.0,), lambda s: s.yaw_rates[1], [0.3, 0.3 + math.radians(1)]),
        ("wheel_speed_dropout", (), lambda s: s.speed, [0.0, 0.0]),
    ],
)
def test_a_fault_changes_its_signal_alone(
    name: str, amount: tuple[float, ...], read: Callable[[CombinationSignals], float], expected: list[float]
) -> None:
    _, faulty = sound_and_faulty(name, amount)
    assert [float(read(one)) for one in faulty[2:4]] == pytest.approx(expected)
    assert all(one.yaw_rates[0] == 0.2 for one in faulty)


class Flicker(ImageFault):
    options: ClassVar[tuple[Option, ...]] = (Option("share", 0.5, "share of images", low=0.0, high=1.0),)

    def __init__(self, amount: tuple[float, ...], context: FaultContext) -> None:
        (self._share,), self._rng = amount, context.rng

    def degraded(self, image: GreyImage, camera: int) -> GreyImage:
        return np.full_like(image, 255) if self._rng.random() < self._share else image


class Scrambled(AnySensorFault):
    def __init__(self, amount: tuple[float, ...], context: FaultContext) -> None:
        pass

    def sample(self, sensor: Sensor[T, Message], truth: T, active: bool) -> Message | None:
        return SlipReading(tick=truth.tick, slip_angle=0.0, wheel_slip=0.0)


def test_a_kind_of_ones_own_works_like_the_others() -> None:
    faulty = on_rover(Fault(name="own:Flicker", kind=Flicker))
    images = [view.image for k in range(100) if (view := faulty.sample(Time(k))) is not None]
    white = [bool((image == 255).all()) for image in images]
    assert len(white) == 100
    assert sum(white) == pytest.approx(50, abs=4.0 * math.sqrt(100 * 0.25))  # four standard deviations
    assert all(np.array_equal(image, np.roll(SCENE, k, axis=1)) for k, image in enumerate(images) if not white[k])


def test_a_kind_that_returns_another_message_is_stopped() -> None:
    faulty = on_rover(Fault(name="own:Scrambled", kind=Scrambled))
    with pytest.raises(ValueError, match="own:Scrambled returned SlipReading instead of RoverView"):
        faulty.sample(Time(0))


def test_the_message_of_a_sensor_is_read_from_its_annotation() -> None:

    class Mute:
        def sample(self, truth: Stamped) -> None: ...

    assert message_type(Counting()) is StereoFrame
    assert message_type(Sonar()) is Echo
    with pytest.raises(ValueError, match=r"Mute\.sample must be annotated with the message it returns"):
        message_type(Mute())


@pytest.mark.parametrize("name", FAULTS)
def test_every_kind_describes_itself(name: str) -> None:
    """Defaults lie within the limits, the class says in one line what it does, and some sensor can have it."""
    kind = KINDS[name]
    assert name in {*MESSAGE_KINDS, *IMAGE_KINDS, *STEREO_KINDS, *SIGNAL_KINDS}
    Fault(name=name, kind=kind, amount=defaults(kind))
    assert all(option.name and option.meaning for option in kind.options)
    assert kind.needs.startswith("a ")
    assert (kind.__doc__ or "").splitlines()[0].endswith(".")
