"""Writer of a rover's recording."""

from __future__ import annotations

import math
from pathlib import Path
from types import TracebackType

import numpy as np

from scenarios.recordings.png import write_png
from scenarios.recordings.rover_format import IMAGES, READINGS, RIG, SLIP, SLIP_COLUMNS, columns, rig_toml
from scenarios.results.run_directory import check_run_directory
from sensors.messages import RoverView
from sensors.sand.trace_rig import TraceRig
from vehicle.clock import TICK
from vehicle.rover.truth import RoverTruth


class RoverRecordingWriter:
    """Writes a recording view by view under a working name, which becomes the final name at the end."""

    def __init__(self, directory: Path, rig: TraceRig) -> None:
        check_run_directory(directory)
        self._directory = directory.resolve()
        self._unfinished = self._directory.with_name(f".{self._directory.name}.unfinished")
        self._rig, self._count = rig, 0

    def __enter__(self) -> RoverRecordingWriter:
        (self._unfinished / IMAGES).mkdir(parents=True)
        (self._unfinished / RIG).write_text(rig_toml(self._rig), encoding="utf-8")
        (self._unfinished / READINGS).write_text(",".join(columns(self._rig)) + "\n", encoding="utf-8")
        (self._unfinished / SLIP).write_text(",".join(SLIP_COLUMNS) + "\n", encoding="utf-8")
        return self

    def add(self, view: RoverView, truth: RoverTruth) -> None:
        """Append a view and the true slip angle at its capture."""
        write_png(self._unfinished / IMAGES / f"{self._count:06d}.png", view.image)
        time = f"{view.tick * TICK:.3f}"
        steer = np.degrees(view.steer)
        numbers = [math.degrees(view.heading), *view.wheel_speeds.tolist(), *steer.tolist()]
        self._append(READINGS, ",".join([time, *(f"{number:.9g}" for number in numbers)]))
        self._append(SLIP, f"{time},{math.degrees(truth.slip_angle):.9g}")
        self._count += 1

    def _append(self, name: str, line: str) -> None:
        with (self._unfinished / name).open("a", encoding="utf-8") as file:
            file.write(line + "\n")

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            if self._directory.is_dir():
                self._directory.rmdir()  # it is empty: check_run_directory accepts no other
            self._unfinished.rename(self._directory)
