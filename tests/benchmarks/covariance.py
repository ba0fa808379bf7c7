"""Stated covariances against errors and disagreements: ``python -m tests.benchmarks.covariance [RECORDING ...]``.

Short drives are rendered once into a folder, and estimated with every odometry; recordings of one's own are estimated
after them. A line each:

- halves, backwards: RMS difference of motions from left and right halves of the images, and of motions forwards and
  backwards in time, in stated standard deviations (goal .7 to 1.5);
- motions: mean squared error of single motions against the recorded poses, in stated variances;
- NEES: the same of the off-tracking (goal .5 to 1.3 in the mean over drives), the share within 2.5 standard deviations,
  the largest error in these, and the largest while the health is ok.
"""

import argparse
import math
import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from estimators.context import Odometry
from estimators.estimates import Health
from estimators.odometry.agreement import Agreement, agreement
from offtrack.exchange.recordings.camera_files import MountingOptions
from offtrack.exchange.recordings.estimation import (
    Chosen,
    Estimation,
    estimate,
    motion_errors,
    off_tracking_source,
    straight_frames,
)
from offtrack.exchange.recordings.stereo_reader import open_recording
from offtrack.exchange.recordings.writers import recording_in
from scenarios.catalogue import ODOMETRY, resolve
from scenarios.loop.runner import run
from scenarios.options.scenario import load_scenario
from sensors.camera.rig import StereoCalibration
from vehicle.frames import FloatArray

_DRIVES: Final = tomllib.loads(Path(__file__).with_name("drives.toml").read_text(encoding="utf-8"))
_COMPARED: Final = 60  # first frames of a drive that are compared with themselves; that takes the longest
_HEADER: Final = "halves  backwards  motions   NEES  within  worst     ok"


class Figures(NamedTuple):
    """Errors and disagreements of a recording, in stated standard deviations."""

    agreement: Agreement
    motions: FloatArray  # (n, 6)
    off_tracking: FloatArray  # (m,)
    ok: FloatArray  # (k,) those of them whose health is ok

    def numbers(self) -> tuple[float, ...]:
        """Numbers of a line, as in the header."""
        return (
            *(_rms(differences) for differences in self.agreement),
            _rms(self.motions) ** 2,
            _rms(self.off_tracking) ** 2,
            float(np.mean(np.abs(self.off_tracking) < 2.5)) if self.off_tracking.size else math.nan,
            *(float(np.abs(errors).max(initial=0.0)) for errors in (self.off_tracking, self.ok)),
        )


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recordings", type=Path, nargs="*")
    parser.add_argument("--set", choices=[*_DRIVES["sets"], "none"], help="drives: of one set; all by default")
    parser.add_argument("--odometry", help="names with commas between them; all by default")
    parser.add_argument("--folder", type=Path, help="where rendered drives are kept; by default they are not")
    options = parser.parse_args()
    names = options.odometry.split(",") if options.odometry else sorted(ODOMETRY)
    with ExitStack() as cleanup:
        folder = options.folder or Path(cleanup.enter_context(tempfile.TemporaryDirectory(prefix="offtrack-drives-")))
        folder.mkdir(parents=True, exist_ok=True)
        for name in names:
            kind = resolve("--odometry", name, ODOMETRY)
            print(f"{name:22s} {_HEADER}")
            for title, rows in _DRIVES["sets"].items():
                if options.set in (None, title):
                    whole = []
                    for drive, place, self_calibration in recorded(folder, rows):
                        whole.append(measured(place, name, kind, self_calibration=self_calibration))
                        _print(drive, whole[-1:])
                    _print(f"all of {title}", whole)
            for recording in options.recordings:
                _print(recording.name, [measured(recording, name, kind, self_calibration=True)])
    return 0


def recorded(folder: Path, rows: Sequence[Sequence[Any]]) -> Iterator[tuple[str, Path, bool]]:
    """Name and images of each drive, and whether its run estimates the rotation of the right camera.

    Drives that are not in the folder yet are rendered.
    """
    for name, scenario_name, seed, *words in rows:
        settings = [setting for word in ("all", *words) for setting in _DRIVES["groups"].get(word, [word])]
        scenario, place = load_scenario(scenario_name, settings), folder / f"{scenario_name}-{seed}"
        if not place.exists():
            run(scenario, seed, record=recording_in(place))
        yield name, place, scenario.rig.self_calibration


def measured(
    directory: Path, odometry: str, kind: Callable[[StereoCalibration], Odometry[Any]], *, self_calibration: bool
) -> Figures:
    """Figures of the recording in a folder, as `offtrack estimate off-tracking` estimates it."""
    source, recording = off_tracking_source(
        open_recording(directory, options=MountingOptions()),
        Chosen(odometry=odometry, self_calibration=self_calibration),
    )
    estimation = estimate(recording, source)
    compared = agreement(recording.calibration, straight_frames(estimation, _COMPARED), kind)
    off_tracking, ok = _errors(estimation)
    return Figures(compared, motion_errors(estimation), off_tracking, off_tracking[ok])


def _errors(estimation: Estimation) -> tuple[FloatArray, FloatArray]:
    """Errors of the off-tracking in stated standard deviations, and which of them have the health ok."""
    found = [
        ((estimate.value - true) / estimate.std, estimate.health is Health.OK)
        for true, frame in zip(estimation.reference, estimation.frames, strict=True)
        if (estimate := frame.off_tracking) is not None and estimate.health is not Health.LOST and math.isfinite(true)
    ]
    return np.array([error for error, _ in found]), np.array([ok for _, ok in found], dtype=bool)


def _print(title: str, figures: Sequence[Figures]) -> None:
    """A line with the means over recordings; of the largest errors the largest, and all shares by their estimates."""
    numbers = np.array([one.numbers() for one in figures])
    mean, largest = np.nanmean(numbers, axis=0), np.nanmax(numbers, axis=0)
    halves, backwards = np.sqrt(np.nanmean(np.square(numbers[:, :2]), axis=0))
    print(
        f"{title:22s} {halves:6.2f} {backwards:10.2f} {mean[2]:8.2f} {mean[3]:6.2f} {100.0 * mean[4]:6.1f}% "
        f"{largest[5]:6.2f} {largest[6]:6.2f}",
        flush=True,
    )


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else math.nan


if __name__ == "__main__":
    sys.exit(main())
