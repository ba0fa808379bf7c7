"""Repeated frames and views: what tells them from those of a vehicle at standstill."""

from dataclasses import replace

import numpy as np
import pytest

from estimators.estimates import Health, SlipAngle, lost_motion
from estimators.odometry.repeated_frames import NewViews, NewViewsMemory, is_repeated, visible_noise
from estimators.slip.rover_odometry import ReferenceSlip
from sensors.messages import GreyImage, RoverView, SlipReading
from tests.estimators.stereo_scene import NOISE as RENDERED
from tests.estimators.stereo_scene import Drive

STANDING = 43  # first frame of the drive that is where the one before was


def test_noise_is_seen_at_standstill_and_under_way(drive: Drive) -> None:
    """Mean difference of two normal numbers: 2 / sqrt(pi) standard deviations; the quietest cell has a little less."""
    expected = 2.0 / np.sqrt(np.pi) * RENDERED
    for first in (20, STANDING):
        noise = visible_noise(drive.frames[first].left, drive.frames[first + 1].left)
        assert 0.7 * expected < noise < 1.1 * expected


def test_standstill_is_not_repeated(drive: Drive) -> None:
    """New noise, so a new image; the same noise again is the same image again."""
    one, other = (frame.left for frame in drive.frames[STANDING : STANDING + 2])
    still = replace(lost_motion(4300, 4200), health=Health.OK)
    assert not is_repeated(one, other, 2.0, still)
    assert is_repeated(one, one.copy(), 2.0, still)
    assert not is_repeated(one, one.copy(), 0.0, still)  # a camera without noise
    assert is_repeated(one, one.copy(), 0.0, None)


RADIUS = 0.1  # [m]
ROLLING = 0.8  # of a wheel: 8 cm/s [rad/s]
PERIOD = 200  # [ticks]
NOISE = 2.0  # of the images, 1 sigma [grey levels]
SAND = np.random.default_rng(1).uniform(60.0, 200.0, (120, 160))


class Counting(ReferenceSlip):
    def init(self) -> int:  # type: ignore[override]
        return 0

    def step(self, memory: int, view: RoverView) -> tuple[int, SlipAngle]:  # type: ignore[override]
        reading = SlipReading(tick=view.tick, slip_angle=0.1, wheel_slip=0.1)
        return memory + 1, super().step(None, reading)[1]


def image(k: int, *, shift: int = 0, noise: float = NOISE) -> GreyImage:
    """Image k of the sand, which has moved by ``shift`` [px]."""
    noisy = np.roll(SAND, shift, axis=0) + np.random.default_rng(100 + k).normal(0.0, noise, SAND.shape)
    return noisy.clip(0.0, 255.0).astype(np.uint8)


def seen(images: list[GreyImage], speed: float) -> tuple[NewViewsMemory, list[Health]]:
    """Memory after views of these images by a rover whose wheels turn at a ``speed`` [rad/s], and all healths."""
    watch = NewViews(Counting(), RADIUS)
    memory, healths = watch.init(), []
    for k, each in enumerate(images):
        view = RoverView(tick=k * PERIOD, image=each, heading=0.0, wheel_speeds=np.full(4, speed), steer=np.zeros(4))
        memory, estimate = watch.step(memory, view)
        assert estimate.tick == view.tick
        healths.append(estimate.health)
    return memory, healths


@pytest.mark.parametrize("noise", [NOISE, 0.0])
def test_an_image_that_repeats_under_way_is_lost_and_not_passed_on(noise: float) -> None:
    """The ground moves by 16 mm, some pixels: even without noise an image differs from the one before."""
    images = [image(k, shift=5 * k, noise=noise) for k in range(4)]
    memory, healths = seen([*images[:2], images[1], images[1], *images[2:]], ROLLING)
    assert healths == [Health.OK, Health.OK, Health.LOST, Health.LOST, Health.OK, Health.OK]
    assert memory.estimator == 4


def test_a_rover_at_standstill_is_not_taken_for_a_frozen_camera() -> None:
    still = [image(k) for k in range(3)]
    assert seen(still, 0.0)[1] == [Health.OK] * 3
    assert seen([image(0, noise=0.0)] * 3, 0.0)[1] == [Health.OK] * 3
    assert seen([*still, still[-1]], 0.0)[1][-1] is Health.LOST


def test_black_images_are_lost() -> None:
    black = np.zeros_like(image(0))
    assert seen([image(0), black, black, image(1, shift=15)], ROLLING)[1][2:] == [Health.LOST, Health.OK]


def test_other_messages_are_passed_on() -> None:
    """An exact instrument repeats its reading when the slip is the same."""
    watch = NewViews(ReferenceSlip(), RADIUS)
    memory = watch.init()
    for tick in (0, 200):
        memory, estimate = watch.step(memory, SlipReading(tick=tick, slip_angle=0.1, wheel_slip=0.1))
        assert estimate.health is Health.OK
