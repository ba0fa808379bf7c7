"""Cost of exposures that differ, between the cameras and over time: ``python -m tests.benchmarks.exposure``.

Short drives are rendered once, and estimated with changed grey levels that are clipped at 0 and 255. Printed are RMS
errors over those with the exposures as they are, of the off-tracking and of the translation of single motions: pooled
over the drives, then of each one. The change ``noise`` adds half a grey level of noise: what it costs is scatter.
One drive is one random walk: ``--seeds`` takes several of each. The change ``both to 127`` limits both images without a
gain: it shows the cost of clipping alone. ``--images`` keeps the rendered drives in a folder for the next time.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from estimators.calibration.rectification import Rectifier
from estimators.estimates import Health
from offtrack.exchange.recordings.estimation import Chosen, Estimation, estimate, off_tracking_source
from offtrack.exchange.recordings.stereo_reader import Recording, open_recording
from offtrack.exchange.recordings.writers import recording_in
from scenarios.loop.runner import run
from scenarios.options.scenario import load_scenario
from sensors.messages import GreyImage, StereoFrame
from vehicle.frames import FloatArray, inverse


class Drive(NamedTuple):
    """A scenario that is rendered with some seeds."""

    name: str
    scenario: str
    seed: int  # the first
    settings: tuple[str, ...]


_TURNED: Final = "rig.misrotation_deg=[{}, {}, {}]"  # roll, yaw, pitch of the right camera
_SHORT: Final = ("course.entry=20", "course.exit=5")
DRIVES: Final = (
    Drive("roundabout", "roundabout", 1, ("course.turn_deg=60", *_SHORT, _TURNED.format(-0.15, 0.10, 0.05))),
    Drive("slip", "constant-slip", 3, ("course.length=50", _TURNED.format(0.10, -0.10, -0.05))),
    Drive("turn", "turn-90", 4, ("speed_kmh=15", *_SHORT, _TURNED.format(0.20, 0.05, 0.10))),
    Drive("straight rig", "roundabout-right", 2, ("course.turn_deg=60", *_SHORT)),
)
_RENDERED: Final = ("off_tracking=truth",)  # the loop needs no estimates

Levels = tuple[float, float]  # gain, and offset [grey levels]
SAME: Final = (1.0, 0.0)
_LIMITED: Final = (1.0, -np.inf)  # levels above 127 become 127
Change = Callable[[int], tuple[Levels, Levels]]  # exposures of left and right image of the frame with this number


def _right(gain: float, offset: float = 0.0) -> Change:
    return lambda number: (SAME, (gain, offset))


def _in_turn(*levels: Levels, frames: int = 1) -> Change:
    """Exposure of both cameras that changes every so many frames."""
    return lambda number: (levels[number // frames % len(levels)],) * 2


def _wandering(number: int) -> tuple[Levels, Levels]:
    """Random gain of both cameras, from one frame to the next by a factor of two at most."""
    gain = 2.0 ** np.random.default_rng(number).uniform(-0.5, 0.5)
    return (gain, 0.0), (gain, 0.0)


def _swinging(number: int) -> tuple[Levels, Levels]:
    """Gain of the right camera between a half and two, to and fro in four seconds."""
    return SAME, (2.0 ** np.sin(2.0 * np.pi * number / 40.0), 0.0)


def _limited(number: int) -> tuple[Levels, Levels]:
    """Both images to the levels that a gain of two leaves in one."""
    return _LIMITED, _LIMITED


CHANGES: Final[dict[str, Change]] = {
    "right x 0.5": _right(0.5),
    "right x 0.7": _right(0.7),
    "right x 1.4": _right(1.4),
    "right x 2": _right(2.0),
    "right + 30": _right(1.0, 30.0),
    "right - 30": _right(1.0, -30.0),
    "right x 0.5 + 30": _right(0.5, 30.0),
    "right x 0.7 - 30": _right(0.7, -30.0),
    "right x 1.4 + 30": _right(1.4, 30.0),
    "right x 2 - 30": _right(2.0, -30.0),
    "both to 127": _limited,
    "both x 1, 0.5": _in_turn(SAME, (0.5, 0.0)),
    "both x 1, 2": _in_turn(SAME, (2.0, 0.0)),
    "both + 0, 30": _in_turn(SAME, (1.0, 30.0)),
    "both x 2 for 1 s": _in_turn(SAME, (2.0, 0.0), frames=10),
    "both wander": _wandering,
    "right swings": _swinging,
}
_NONE: Final = "none"
_NOISE: Final = "noise"
_NOISE_LEVELS: Final = 0.5  # [grey levels]


class Exposed(Rectifier):
    """Rectification of a recording whose exposures are changed."""

    def __init__(self, recording: Recording, change: str) -> None:
        self.recording, self.change = recording, change
        self._calibration = recording.calibration

    def step(self, frame: StereoFrame) -> StereoFrame:
        """The pair with its grey levels changed."""
        frame = self.recording.rectified(frame)
        if self.change == _NONE:
            return frame
        if self.change == _NOISE:
            rng = np.random.default_rng(frame.tick)
            return replace(frame, left=_noisy(frame.left, rng), right=_noisy(frame.right, rng))
        left, right = CHANGES[self.change](frame.tick // 100)
        return replace(frame, left=_exposed(frame.left, left), right=_exposed(frame.right, right))


def _noisy(image: GreyImage, rng: np.random.Generator) -> GreyImage:
    return np.asarray(np.clip(np.rint(rng.normal(image, _NOISE_LEVELS)), 0, 255), dtype=np.uint8)


def _exposed(image: GreyImage, levels: Levels) -> GreyImage:
    if levels == _LIMITED:
        return np.minimum(image, 127)
    gain, offset = levels
    table = np.clip(np.rint(gain * np.arange(256.0) + offset), 0.0, 255.0).astype(np.uint8)
    return np.asarray(table[image], dtype=np.uint8)


class Errors(NamedTuple):
    """Errors of a drive."""

    off_tracking: FloatArray  # (n,) [m]
    motions: FloatArray  # (m,) of the translation [m]
    lost: int  # motions


def main() -> int:
    """Render, estimate and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--images", type=Path, help="folder that keeps the rendered drives")
    parser.add_argument("--seeds", type=int, default=1, help="of each drive (default 1)")
    parser.add_argument("--odometry", action="append", choices=["keyframe", "circular", "viso2"], default=[])
    parser.add_argument("--calibration", choices=["corrected", "watched", "both"], default="both")
    parser.add_argument("--change", action="append", default=[], help="see the table")
    parser.add_argument("--drive", action="append", default=[], help=", ".join(drive.name for drive in DRIVES))
    options = parser.parse_args()
    drives = [drive for drive in DRIVES if drive.name in (options.drive or [drive.name])]
    changes = options.change or [_NOISE, *CHANGES]
    with tempfile.TemporaryDirectory(prefix="offtrack-exposure-") as temporary:
        recordings = rendered(drives, options.seeds, options.images or Path(temporary))
        for odometry in options.odometry or ("keyframe", "circular", "viso2"):
            for corrected in {"corrected": (True,), "watched": (False,), "both": (True, False)}[options.calibration]:
                chosen = Chosen(odometry=odometry, self_calibration=corrected)
                for line in table(recordings, chosen, changes):
                    print(line, flush=True)
    return 0


def rendered(drives: Sequence[Drive], seeds: int, folder: Path) -> dict[str, list[Recording]]:
    """Recordings of the drives, one for each seed; what is in the folder is not rendered again."""
    recordings: dict[str, list[Recording]] = {}
    for drive in drives:
        for seed in range(drive.seed, drive.seed + seeds):
            images = folder / f"{drive.name.replace(' ', '-')}-{seed}"
            if not images.exists():
                run(load_scenario(drive.scenario, [*_RENDERED, *drive.settings]), seed, record=recording_in(images))
            recordings.setdefault(drive.name, []).append(open_recording(images))
    return recordings


def table(recordings: dict[str, list[Recording]], chosen: Chosen, changes: Sequence[str]) -> Iterator[str]:
    """Lines of the table for an odometry."""
    yield f"{chosen.odometry}, calibration {'corrected' if chosen.self_calibration else 'watched'}"
    clean = {name: _pooled(of_drive, chosen, _NONE) for name, of_drive in recordings.items()}
    for part in ("off_tracking", "motions"):
        parts = [getattr(errors, part) for errors in clean.values()]
        each = ", ".join(f"{1e3 * _rms(errors):.3f}" for errors in parts)
        yield f"  {part}: RMS {1e3 * _rms(np.concatenate(parts)):.3f} mm, of {', '.join(clean)}: {each}"
    for change in changes:
        changed = {name: _pooled(of_drive, chosen, change) for name, of_drive in recordings.items()}
        cells = [_ratios([getattr(e, part) for e in changed.values()], [getattr(e, part) for e in clean.values()])
                 for part in ("off_tracking", "motions")]  # fmt: skip
        lost = [sum(errors.lost for errors in of_all.values()) for of_all in (changed, clean)]
        yield f"  {change:18s} off-tracking {cells[0]}   motions {cells[1]}   lost {lost[0]} ({lost[1]})"


def _pooled(recordings: Sequence[Recording], chosen: Chosen, change: str) -> Errors:
    """Errors over the recordings of a drive."""
    off_tracking, motions, lost = zip(*(_errors(recording, chosen, change) for recording in recordings), strict=True)
    return Errors(np.concatenate(off_tracking), np.concatenate(motions), sum(lost))


def _ratios(changed: Sequence[FloatArray], clean: Sequence[FloatArray]) -> str:
    """Ratio of the pooled RMS errors, and of each drive."""
    each = " ".join(f"{_rms(a) / _rms(b):.2f}" for a, b in zip(changed, clean, strict=True))
    return f"{_rms(np.concatenate(changed)) / _rms(np.concatenate(clean)):.2f} ({each})"


def _errors(recording: Recording, chosen: Chosen, change: str) -> Errors:
    """Errors of the estimates from the recording with changed exposures."""
    recording = replace(recording, rectification=Exposed(recording, change))
    source, recording = off_tracking_source(recording, chosen)
    estimation = estimate(recording, source)
    off_tracking = [
        frame.off_tracking.value - true
        for frame, true in zip(estimation.frames, estimation.reference, strict=True)
        if frame.off_tracking is not None and frame.off_tracking.health is not Health.LOST and np.isfinite(true)
    ]
    return Errors(np.array(off_tracking), *_motion_errors(estimation))


def _motion_errors(estimation: Estimation) -> tuple[FloatArray, int]:
    """Errors (m,) of the translations of the motions [m], and the number of lost ones."""
    assert estimation.recording.poses is not None
    pose = {frame.files.tick: X for frame, X in zip(estimation.frames, estimation.recording.poses, strict=True)}
    motions = [frame.motion for frame in estimation.frames if frame.motion is not None]
    found = [motion for motion in motions if motion.health is not Health.LOST]
    errors = [(inverse(pose[m.previous_tick]) @ pose[m.tick] - m.X_PC)[:3, 3] for m in found]
    return np.linalg.norm(np.array(errors).reshape(-1, 3), axis=1), len(motions) - len(found)


def _rms(errors: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))


if __name__ == "__main__":
    sys.exit(main())
