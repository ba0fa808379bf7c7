"""Recovery of an odometry from a disturbed second: ``python -m tests.benchmarks.recovery RECORDING``.

The recording has 20 frames a second, of which every other one is taken; one of a constant speed is best:
``offtrack run constant-slip --set rig.rate_hz=20 --set speed_kmh=40 --set course.length=70 --record RECORDING``.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from estimators.estimates import CameraOffTracking, Health
from scenarios.recordings.images import Dropped, stream
from scenarios.recordings.mounting import MountingOptions
from scenarios.recordings.off_tracking_source import Chosen, off_tracking_source
from scenarios.recordings.stereo_reader import Recording, open_recording
from sensors.messages import GreyImage, StereoFrame

_SECOND: Final = 10  # frames
_NOISE: Final = 1.5  # of a camera that stands [grey levels]


class Disturbance(NamedTuple):
    """Frames of a drive of which some are disturbed, and the tick of the last of these."""

    frames: list[StereoFrame]
    until: int


def main() -> int:
    """Replay all disturbances and print the first sound frame that is well again."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--odometry", default="keyframe")
    parser.add_argument("--after", type=float, default=3.0, help="undisturbed time before [s]")
    options = parser.parse_args()
    recording = open_recording(options.recording, calibration_file=None, rate_hz=None, options=MountingOptions())
    images = [frame for _, frame in stream(recording.sequence.frames, recording.size)]
    frames = [recording.rectified(frame) for frame in images if not isinstance(frame, Dropped)]
    for name, disturbance in disturbances(frames, round(options.after * _SECOND)).items():
        motion, off_tracking = _first_well(recording, options.odometry, disturbance)
        print(f"{name:20s} motion ok at sound frame {motion or '-'}, off-tracking at {off_tracking or '-'}", flush=True)
    return 0


def disturbances(frames: Sequence[StereoFrame], count: int) -> dict[str, Disturbance]:
    """Disturbances that begin after ``count`` frames and last a second, of frames at the double rate."""
    rng, every = np.random.default_rng(1), list(frames[::2])
    before, disturbed, after = every[:count], every[count : count + _SECOND], every[count + _SECOND :]
    last, period = before[-1], every[1].tick - every[0].tick
    black, noise = np.zeros_like(last.left), rng.integers(0, 256, last.left.shape).astype(np.uint8)
    repeated = [last]
    for frame in disturbed:
        repeated.append(_showing(frame, repeated[-1]) if rng.random() < 0.5 else frame)

    def standing(image: GreyImage) -> GreyImage:
        return np.asarray(np.clip(image + rng.normal(0.0, _NOISE, image.shape), 0, 255), dtype=np.uint8)

    def brighter(image: GreyImage, gain: float) -> GreyImage:
        return np.asarray(np.clip(gain * image, 0, 255), dtype=np.uint8)

    seconds: dict[str, list[StereoFrame]] = {
        "none": disturbed,
        "frozen": [_showing(frame, last) for frame in disturbed],
        "black": [replace(frame, left=black, right=black) for frame in disturbed],
        "lost": [],
        "noise": [replace(frame, left=noise, right=noise[::-1].copy()) for frame in disturbed],
        "half repeated": repeated[1:],
        "half rate": disturbed[::2],
        "double rate": [frame for frame in frames if disturbed[0].tick <= frame.tick < after[0].tick],
        "every frame twice": [
            replace(frame, tick=frame.tick + late) for frame in disturbed for late in (0, period // 2)
        ],
        "right a frame late": [
            replace(frame, right=previous.right) for frame, previous in zip(disturbed, every[count - 1 :], strict=False)
        ],
        "right half as bright": [replace(frame, right=brighter(frame.right, 0.5)) for frame in disturbed],
        "right twice as bright": [replace(frame, right=brighter(frame.right, 2.0)) for frame in disturbed],
    }
    result = {name: Disturbance([*before, *second, *after], after[0].tick - 1) for name, second in seconds.items()}
    pause = _SECOND * period
    still = [
        replace(last, tick=last.tick + (k + 1) * period, left=standing(last.left), right=standing(last.right))
        for k in range(_SECOND)
    ]
    goes_on = [replace(frame, tick=frame.tick + pause) for frame in (*disturbed, *after)]
    result["the vehicle stands"] = Disturbance([*before, *still, *goes_on], last.tick + pause)
    return result


def _showing(frame: StereoFrame, other: StereoFrame) -> StereoFrame:
    """The frame with the images of another one."""
    return replace(frame, left=other.left, right=other.right)


def _first_well(recording: Recording, odometry: str, disturbance: Disturbance) -> tuple[int | None, int | None]:
    """Numbers of the first sound frames, from 1, whose motion and whose off-tracking are ok; None: there is none."""
    source, _ = off_tracking_source(recording, Chosen(odometry=odometry))
    memory, motions, values = source.init(), [], []
    for frame in disturbance.frames:
        memory, estimate = source.step(memory, frame)
        if isinstance(estimate, CameraOffTracking) and frame.tick > disturbance.until:
            motions.append(estimate.motion is not None and estimate.motion.health is Health.OK)
            values.append(estimate.off_tracking.health is Health.OK)
    return _first(motions), _first(values)


def _first(well: Sequence[bool]) -> int | None:
    return well.index(True) + 1 if True in well else None


if __name__ == "__main__":
    sys.exit(main())
