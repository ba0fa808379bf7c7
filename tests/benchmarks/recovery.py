"""Recovery of an odometry from a disturbed second: ``python -m tests.benchmarks.recovery RECORDING``.

Frames 0.1 s apart are taken from a recording; one of a constant speed is best. With 20 frames a second it has those
for the double rate and for a right camera that is 50 ms late, with 100 also those for one that is 20 ms late:
``offtrack run constant-slip --set rig.rate_hz=20 --set speed_kmh=40 --set course.length=75 --record RECORDING``.
"""

import argparse
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np

from estimators.context import OffTrackingSource
from estimators.estimates import CameraOffTracking, Health, Motion
from estimators.rigid_motion import rotation_vector
from offtrack.exchange.recordings.camera_files import MountingOptions
from offtrack.exchange.recordings.estimation import Chosen, off_tracking_source
from offtrack.exchange.recordings.stereo_reader import Recording, open_recording
from offtrack.exchange.recordings.stereo_sequence import Dropped, stream
from tests.benchmarks.disturbances import SECOND, Disturbance, Drive, disturbances
from vehicle.frames import inverse

_SOON: Final = 3  # sound frames within which a motion must be well again
_SETTLED: Final = 5  # further ones whose errors are looked at


def main() -> int:
    """Replay the disturbances; exit code 1 if a motion is not well again within three sound frames."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--odometry", default="keyframe")
    parser.add_argument("--after", type=float, default=3.0, help="undisturbed time before [s]")
    parser.add_argument("--only", default="", help="disturbances whose name contains this")
    options = parser.parse_args()
    recording = open_recording(options.recording, options=MountingOptions())
    before, disturbed = disturbances(_drive(recording), round(options.after * SECOND))
    source, _ = off_tracking_source(recording, Chosen(odometry=options.odometry))
    memory, slow = source.init(), False
    for frame in before:
        memory, _ = source.step(memory, frame)
    for name, disturbance in disturbed.items():
        if options.only in name:
            motion, value, error = _recovered(source, memory, disturbance)
            slow |= motion is None or motion > _SOON
            found = f"motion ok at sound frame {motion or '-'}, off-tracking at {value or '-'}"
            print(f"{name:26s} {found}, ok motions within {error:.1f} sigma", flush=True)
    return int(slow)


def _drive(recording: Recording) -> Drive:
    """The whole recording in memory."""
    frames, poses = {}, {}
    for k, (_, frame) in enumerate(stream(recording.sequence.frames, recording.size)):
        if not isinstance(frame, Dropped):
            frames[frame.tick] = recording.rectified(frame)
            if recording.poses is not None:
                poses[frame.tick] = recording.poses[k]
    return Drive(recording.calibration, frames, poses)


def _recovered(
    source: OffTrackingSource, memory: Any, disturbance: Disturbance
) -> tuple[int | None, int | None, float]:
    """First sound frames, from 1, whose motion and whose off-tracking are ok; None: there is none.

    And the largest error of ok motions since the first disturbed frame [stated standard deviations]; NaN: not known.
    """
    well: tuple[list[bool], list[bool]] = [], []
    errors = [0.0]
    for frame in disturbance.frames:
        memory, estimate = source.step(memory, frame)
        if not isinstance(estimate, CameraOffTracking):
            continue
        motion = estimate.motion if estimate.motion and estimate.motion.health is Health.OK else None
        if motion is not None:
            errors.append(_error(motion, disturbance))
        if frame.tick > disturbance.until:
            well[0].append(motion is not None)
            well[1].append(estimate.off_tracking.health is Health.OK)
        if True in well[0][:-_SETTLED] and True in well[1]:
            break
    first_motion, first_value = (one.index(True) + 1 if True in one else None for one in well)
    return first_motion, first_value, max(errors)


def _error(motion: Motion, disturbance: Disturbance) -> float:
    """Largest error of a motion's components [stated standard deviations]; NaN without true poses."""
    X_OP, X_OC = (disturbance.poses.get(tick) for tick in (motion.previous_tick, motion.tick))
    if X_OP is None or X_OC is None:
        return np.nan
    X_PC = inverse(X_OP) @ X_OC
    turned = rotation_vector(motion.X_PC[:3, :3] @ X_PC[:3, :3].T)
    error = np.concatenate([turned, motion.X_PC[:3, 3] - X_PC[:3, 3]])
    return float(np.abs(error / np.sqrt(np.diag(motion.covariance))).max())


if __name__ == "__main__":
    sys.exit(main())
