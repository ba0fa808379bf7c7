"""Writer of a rover's recording."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from scenarios.recordings.png import write_png
from scenarios.recordings.recording_folder import RecordingFolder
from scenarios.recordings.rover_format import IMAGES, READINGS, RIG, SLIP, SLIP_COLUMNS, columns, header, rig_toml
from sensors.messages import RoverView
from sensors.sand.trace_rig import TraceRig
from vehicle.clock import TICK
from vehicle.rover.truth import RoverTruth


class RoverRecordingWriter(RecordingFolder):
    """Writes a recording view by view."""

    def __init__(self, directory: Path, rig: TraceRig) -> None:
        super().__init__(directory)
        self._rig, self._count = rig, 0

    def _begin(self) -> None:
        (self._folder / IMAGES).mkdir()
        (self._folder / RIG).write_text(rig_toml(self._rig), encoding="utf-8")
        (self._folder / READINGS).write_text(header(columns(self._rig)), encoding="utf-8")
        (self._folder / SLIP).write_text(header(SLIP_COLUMNS), encoding="utf-8")

    def add(self, view: RoverView, truth: RoverTruth) -> None:
        """Append a view and the true slip angle at its capture."""
        time = f"{view.tick * TICK:.3f}"
        steer = np.degrees(view.steer)
        numbers = [math.degrees(view.heading), *view.wheel_speeds.tolist(), *steer.tolist()]
        write_png(self._folder / IMAGES / f"{self._count:06d}.png", view.image)
        self._append(READINGS, ",".join([time, *(f"{number:.9g}" for number in numbers)]))
        self._append(SLIP, f"{time},{math.degrees(truth.slip_angle):.9g}")
        self._count += 1
