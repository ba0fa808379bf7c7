"""Seconds of a stereo drive, disturbed by what happens to cameras and by the faults of the catalogue."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from sensors.camera.rig import StereoCalibration, mount_rotation
from sensors.faults.fault import FaultContext
from sensors.faults.image_kinds import Decalibration, Dirt, Gain, Glare, ImageFault
from sensors.messages import GreyImage, StereoFrame
from vehicle.frames import FloatArray, transform

PERIOD: Final = 100  # between the frames of a drive [ticks]
SECOND: Final = 1000 // PERIOD  # frames
_NOISE: Final = 1.5  # of a camera that stands [grey levels]
_LATE: Final = (20, 50)  # of a right camera without a trigger line [ticks]

ImageChange = Callable[[GreyImage], GreyImage]


class Drive(NamedTuple):
    """Frames of a recording, a whole part of `PERIOD` apart, and the true poses of its left camera."""

    calibration: StereoCalibration
    frames: Mapping[int, StereoFrame]  # by tick
    poses: Mapping[int, FloatArray]  # (4, 4) by tick; empty: not known


class Disturbance(NamedTuple):
    """Frames from the first disturbed one on, the last tick of the disturbance, and true poses by tick."""

    frames: Sequence[StereoFrame]
    until: int
    poses: Mapping[int, FloatArray]  # empty: not known


def disturbances(drive: Drive, count: int) -> tuple[list[StereoFrame], dict[str, Disturbance]]:
    """The first ``count`` frames, and disturbances of a second that follow them, by name.

    Those that need frames between the frames are left out if the recording has none.
    """
    every = [frame for tick, frame in drive.frames.items() if tick % PERIOD == 0]
    before, disturbed, after = every[:count], every[count : count + SECOND], every[count + SECOND :]
    rng, last = np.random.default_rng(1), before[-1]
    seconds = {
        "none": disturbed,
        **_of_transmission(last, disturbed, rng),
        **_between(drive, disturbed),
        **_of_images(drive.calibration, disturbed, rng),
        "right a frame late": [
            replace(frame, right=previous.right) for frame, previous in zip(disturbed, every[count - 1 :], strict=False)
        ],
    }
    until = after[0].tick - 1
    result = {name: Disturbance([*second, *after], until, drive.poses) for name, second in seconds.items()}
    result["mount nods"] = _nodding(drive, disturbed, after, rng)
    result["the vehicle stands"] = _with_halt(last, [*disturbed, *after], rng)
    return before, result


def _of_transmission(
    last: StereoFrame, disturbed: Sequence[StereoFrame], rng: np.random.Generator
) -> dict[str, Sequence[StereoFrame]]:
    """Seconds after the frame ``last`` in which frames are lost, late, or sent again."""
    repeated = [last]
    for frame in disturbed:
        repeated.append(_showing(frame, repeated[-1]) if rng.random() < 0.5 else frame)
    return {
        "lost": [],
        "half of them lost": [frame for frame in disturbed if rng.random() < 0.5],
        "late, the last three lost": disturbed[:-3],
        "half rate": disturbed[::2],
        "frozen": [_showing(frame, last) for frame in disturbed],
        "half repeated": repeated[1:],
        "every frame twice": [
            replace(frame, tick=frame.tick + late) for frame in disturbed for late in (0, PERIOD // 2)
        ],
    }


def _between(drive: Drive, disturbed: Sequence[StereoFrame]) -> dict[str, Sequence[StereoFrame]]:
    """Seconds made of frames between the frames."""
    result: dict[str, Sequence[StereoFrame]] = {}
    halfway = [drive.frames.get(frame.tick + PERIOD // 2) for frame in disturbed]
    if None not in halfway:
        both = zip(disturbed, halfway, strict=True)
        result["double rate"] = [frame for pair in both for frame in pair if frame is not None]
    for late in _LATE:
        later = [drive.frames.get(frame.tick + late) for frame in disturbed]
        second = [replace(frame, right=other.right) for frame, other in zip(disturbed, later, strict=True) if other]
        if len(second) == len(disturbed):
            result[f"right {late} ms late"] = second
    return result


def _of_images(
    calibration: StereoCalibration, disturbed: Sequence[StereoFrame], rng: np.random.Generator
) -> dict[str, Sequence[StereoFrame]]:
    """Seconds of degraded images."""
    context = FaultContext(message=StereoFrame, camera=calibration, unit=1, rng=rng)
    black = np.zeros((calibration.height, calibration.width), np.uint8)
    noise = rng.integers(0, 256, black.shape).astype(np.uint8)
    faults: dict[str, ImageFault] = {
        "right half as bright": Gain((0.5, 0.0), context),
        "right twice as bright": Gain((2.0, 0.0), context),
        "right brighter by 30": Gain((1.0, 30.0), context),
        "dirt on a third": Dirt((0.3,), context),
        "glare": Glare((1.0,), context),
        "right camera knocked": Decalibration((0.3, 0.3, 0.3), context),
    }
    gains = 2.0 ** np.sin(np.arange(len(disturbed)) * 2.0)

    def degraded(frame: StereoFrame, fault: ImageFault) -> StereoFrame:
        return replace(frame, left=fault.degraded(frame.left, 0), right=fault.degraded(frame.right, 1))

    def brighter(image: GreyImage, gain: float) -> GreyImage:
        return np.asarray(np.clip(gain * image, 0, 255), dtype=np.uint8)

    return {
        "black": [_both(frame, lambda _: black) for frame in disturbed],
        "noise": [replace(frame, left=noise, right=noise[::-1].copy()) for frame in disturbed],
        **{name: [degraded(frame, fault) for frame in disturbed] for name, fault in faults.items()},
        "both of varying brightness": [
            _both(frame, partial(brighter, gain=gain)) for frame, gain in zip(disturbed, gains.tolist(), strict=True)
        ],
    }


def _nodding(
    drive: Drive, disturbed: Sequence[StereoFrame], after: Sequence[StereoFrame], rng: np.random.Generator
) -> Disturbance:
    """A second in which the mount nods by half a degree: about the axis through both cameras, so the pair stays one."""
    nodding, poses = [], dict(drive.poses)
    context = FaultContext(message=StereoFrame, camera=drive.calibration, unit=1, rng=rng)
    for frame in disturbed:
        pitch = float(rng.normal(0.0, 0.5))  # [deg]
        turned = Decalibration((0.0, 0.0, pitch), context)
        nodding.append(_both(frame, partial(turned.degraded, camera=1)))
        if poses:
            poses[frame.tick] = poses[frame.tick] @ transform(mount_rotation(0.0, 0.0, np.radians(pitch)), np.zeros(3))
    return Disturbance([*nodding, *after], after[0].tick - 1, poses)


def _with_halt(last: StereoFrame, after: Sequence[StereoFrame], rng: np.random.Generator) -> Disturbance:
    """A drive that stands for a second after the ``last`` frame, and goes on as if nothing had been.

    No vehicle stops and starts at once: errors mean nothing.
    """

    def standing(image: GreyImage) -> GreyImage:
        return np.asarray(np.clip(image + rng.normal(0.0, _NOISE, image.shape), 0, 255), dtype=np.uint8)

    pause = SECOND * PERIOD
    still = [replace(_both(last, standing), tick=last.tick + (k + 1) * PERIOD) for k in range(SECOND)]
    goes_on = [replace(frame, tick=frame.tick + pause) for frame in after]
    return Disturbance([*still, *goes_on], last.tick + pause, {})


def _showing(frame: StereoFrame, other: StereoFrame) -> StereoFrame:
    """The frame with the images of another one."""
    return replace(frame, left=other.left, right=other.right)


def _both(frame: StereoFrame, change: ImageChange) -> StereoFrame:
    """The frame with both images changed."""
    return replace(frame, left=change(frame.left), right=change(frame.right))
