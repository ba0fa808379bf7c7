"""What faults do to messages, when, and to which."""

from __future__ import annotations

import math
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from sensors.camera.lens import mount_rotation
from sensors.camera.rig import StereoRig
from sensors.faults.fault import KINDS, Fault, Kind
from sensors.faults.wrappers import Message, faulty
from sensors.instruments.navigation import ExactPose
from sensors.messages import BodyPose, StereoFrame
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray

TruthOf = Callable[..., Truth]
PERIOD = 100  # [ticks]
CALIBRATION = StereoRig(
    facing="rear", width=672, height=240, hfov=math.radians(100.0), x=-13.6, y=0.0, z=3.0, baseline=0.5
).calibration()
IMAGE_KINDS: tuple[Kind, ...] = ("desync", "decalibration", "dirt", "glare", "blackout")


def scene() -> NDArray[np.uint8]:
    """Soft blobs of all brightnesses."""
    white = np.random.default_rng(1).uniform(0.0, 255.0, (CALIBRATION.height, CALIBRATION.width))
    smooth = cv2.GaussianBlur(white, (0, 0), 6.0)
    return np.asarray(cv2.normalize(smooth, None, 0, 255, cv2.NORM_MINMAX), dtype=np.uint8)


SCENE = scene()


class Counting:
    """Cameras whose images tell the tick, and where they are, by the whole image's shift in columns."""

    def sample(self, truth: Truth) -> StereoFrame:
        column = round(float(truth.bodies[0, 0, 3]) * 100.0)
        left = np.roll(SCENE, column, axis=1)
        return StereoFrame(tick=truth.tick, left=left, right=left, colour=np.zeros((*SCENE.shape, 3), dtype=np.uint8))


def at(k: int) -> FloatArray:
    """Two metres a second along x."""
    X = np.eye(4)
    X[0, 3] = 0.2 * k
    return X


def sent(truth_of: TruthOf, fault: Fault, captures: int, *, seed: int = 0) -> list[Message | None]:
    """What arrives of so many captures."""
    rng = np.random.default_rng(seed)
    sensor = faulty(Counting(), fault, unit=0, calibration=CALIBRATION, rng=rng)
    return [sensor.sample(truth_of(PERIOD * k, at(k))) for k in range(captures)]


def ticks(messages: list[Message | None]) -> list[int | None]:
    return [message and message.tick for message in messages]


def image(message: Message | None) -> NDArray[np.uint8]:
    assert isinstance(message, StereoFrame)
    return message.left


@pytest.mark.parametrize("kind", KINDS)
def test_no_fault_does_anything_outside_its_time(truth_of: TruthOf, kind: Kind) -> None:
    """From 0.5 s for 0.3 s: captures before and after it are those of a sound sensor."""
    messages = sent(truth_of, Fault(kind=kind, start=0.5, duration=0.3), 12)
    sound = sent(truth_of, Fault(kind="dropout", amount=(0.0,)), 12)
    for k in (*range(5), *range(8, 12)):
        got, expected = messages[k], sound[k]
        assert isinstance(got, StereoFrame)
        assert isinstance(expected, StereoFrame)
        assert got.tick == expected.tick
        assert np.array_equal(got.left, expected.left)
        assert np.array_equal(got.right, expected.right)


def test_dropout_loses_its_share(truth_of: TruthOf) -> None:
    """Of 500 messages a fifth, give or take four standard deviations; the same ones with the same seed."""
    fault = Fault(kind="dropout", amount=(0.2,))
    lost = [message is None for message in sent(truth_of, fault, 500)]
    assert sum(lost) == pytest.approx(100, abs=4.0 * math.sqrt(500 * 0.2 * 0.8))
    assert lost == [message is None for message in sent(truth_of, fault, 500)]
    assert lost != [message is None for message in sent(truth_of, fault, 500, seed=1)]


def test_a_frozen_sensor_repeats_its_last_message_under_new_times(truth_of: TruthOf) -> None:
    """What it sends looks alive to whoever reads only the stamps."""
    messages = sent(truth_of, Fault(kind="freeze", start=0.3, duration=0.2), 6)
    assert ticks(messages) == [0, 100, 200, 300, 400, 500]
    same = [np.array_equal(image(messages[2]), image(message)) for message in messages]
    assert same == [False, False, True, True, True, False]


def test_duplicates_repeat_the_message_before(truth_of: TruthOf) -> None:
    """Of 200 messages a fifth is what was sent before."""
    messages = sent(truth_of, Fault(kind="duplicate", amount=(0.2,)), 200)
    twice = sum(np.array_equal(image(a), image(b)) for a, b in zip(messages[1:], messages[:-1], strict=True))
    assert twice == pytest.approx(40, abs=4.0 * math.sqrt(200 * 0.2 * 0.8))  # four standard deviations
    assert ticks(messages) == [PERIOD * k for k in range(200)]


def test_delayed_messages_keep_the_time_of_their_capture(truth_of: TruthOf) -> None:
    """Two captures late from 0.3 s on: two gaps, and then old news that say how old they are."""
    messages = sent(truth_of, Fault(kind="delay", amount=(2.0,), start=0.3), 8)
    assert ticks(messages) == [0, 100, 200, None, None, 300, 400, 500]


def test_a_late_right_camera_sees_where_the_body_will_be(truth_of: TruthOf) -> None:
    """50 ms at 2 m/s: 10 cm, ten columns of these images; the left camera is on time."""
    messages = sent(truth_of, Fault(kind="desync", amount=(0.05,), start=0.3), 6)
    last = messages[-1]
    assert isinstance(last, StereoFrame)
    assert last.tick == 500
    assert np.array_equal(last.left, np.roll(SCENE, 100, axis=1))
    assert np.array_equal(last.right, np.roll(SCENE, 110, axis=1))


def test_a_knocked_camera_can_be_set_right_by_the_papers_homography(truth_of: TruthOf) -> None:
    """Only the right image turns, by the angles that were asked for."""
    angles = (-0.5, 0.4, 0.2)
    (message,) = sent(truth_of, Fault(kind="decalibration", amount=angles), 1)
    assert isinstance(message, StereoFrame)
    c = CALIBRATION
    K = np.array([[c.focal_length, 0.0, c.cx], [0.0, c.focal_length, c.cy], [0.0, 0.0, 1.0]])
    H = K @ mount_rotation(*np.radians(angles)) @ np.linalg.inv(K)
    back = cv2.warpPerspective(message.right, H, (c.width, c.height)).astype(float)
    assert np.array_equal(message.left, SCENE)
    assert np.abs(back - SCENE)[10:-10, 10:-10].mean() < 1.0  # [grey levels] of interpolating twice
    assert np.abs(message.right.astype(float) - SCENE)[10:-10, 10:-10].mean() > 5.0


def test_what_spoils_images_is_seen_by_people_too(truth_of: TruthOf) -> None:
    """Their picture would otherwise hide the fault."""
    for kind in ("dirt", "glare", "blackout", "decalibration"):
        (message,) = sent(truth_of, Fault(kind=kind), 1)
        assert isinstance(message, StereoFrame)
        assert message.colour is None


def test_blackout_glare_and_dirt(truth_of: TruthOf) -> None:
    """Nothing at all; more light everywhere and white somewhere; a share of each lens in the dark."""
    (black,), (veiled,), (dirty,) = (sent(truth_of, Fault(kind=kind), 1) for kind in ("blackout", "glare", "dirt"))
    assert not image(black).any()
    assert (image(veiled) >= SCENE).all()
    assert (image(veiled) == 255).sum() > (SCENE == 255).sum() + 500
    assert (image(dirty).astype(float) < 0.75 * SCENE).mean() == pytest.approx(0.3, abs=0.08)  # soft edges, dark spots


def test_faults_add_up(truth_of: TruthOf) -> None:
    """A frozen sensor whose messages get lost as well."""
    rng = np.random.default_rng(0)
    frozen = faulty(Counting(), Fault(kind="freeze", start=0.2), unit=0, calibration=CALIBRATION, rng=rng)
    both = faulty(frozen, Fault(kind="dropout", amount=(1.0,), start=0.4), unit=0, calibration=CALIBRATION, rng=rng)
    messages = [both.sample(truth_of(PERIOD * k, at(k))) for k in range(6)]
    assert ticks(messages) == [0, 100, 200, 300, None, None]
    assert np.array_equal(image(messages[3]), image(messages[1]))


def test_late_messages_that_are_not_lost_keep_their_time(truth_of: TruthOf) -> None:
    """The wrapper around another one does not make old news new."""
    rng = np.random.default_rng(0)
    late = faulty(Counting(), Fault(kind="delay"), unit=0, calibration=CALIBRATION, rng=rng)
    both = faulty(late, Fault(kind="dropout", amount=(0.3,)), unit=0, calibration=CALIBRATION, rng=rng)
    for k in range(20):
        message = both.sample(truth_of(PERIOD * k, at(k)))
        assert message is None or message.tick == PERIOD * (k - 1)


@pytest.mark.parametrize("kind", KINDS)
def test_a_reference_unit_can_fail_but_not_be_dirty(truth_of: TruthOf, kind: Kind) -> None:
    """Faults of messages befall any sensor; those of images are refused where there are none."""
    sensor, rng = ExactPose(0), np.random.default_rng(0)
    if kind in IMAGE_KINDS:
        with pytest.raises(ValueError, match=f"fault {kind}: .* not estimated from cameras"):
            faulty(sensor, Fault(kind=kind), unit=0, calibration=None, rng=rng)
        return
    ailing = faulty(sensor, Fault(kind=kind), unit=0, calibration=None, rng=rng)
    messages = [ailing.sample(truth_of(PERIOD * k, at(k))) for k in range(60)]
    assert any(isinstance(message, BodyPose) for message in messages)
    exact = [message is not None and np.array_equal(message.X_WB, at(k)) for k, message in enumerate(messages)]
    assert not all(exact)


@pytest.mark.parametrize(
    ("fault", "complaint"),
    [
        ({"kind": "dropout", "amount": (1.2,)}, r"dropout: amount = \[1.2\] must be 1 of 0 to 1"),
        ({"kind": "decalibration", "amount": (0.1,)}, "decalibration: .* must be 3 of -5 to 5"),
        ({"kind": "blackout", "amount": (0.5,)}, "blackout: .* must be none"),
        ({"kind": "delay", "amount": (1.5,)}, "whole number of captures"),
        ({"kind": "freeze", "start": -1.0}, "start = -1.0 s"),
        ({"kind": "freeze", "duration": 0.0}, "duration = 0.0 s"),
    ],
)
def test_faults_that_can_not_be_are_refused(fault: dict[str, object], complaint: str) -> None:
    """One line with the kind, the value and its limits."""
    with pytest.raises(ValueError, match=complaint):
        Fault(**fault)
