"""Reader of a rover's recording."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scenarios.image_file import read_grey_upright
from scenarios.recordings.rover_format import IMAGES, READINGS, RIG, SLIP, SLIP_COLUMNS, columns, load_rig
from sensors.messages import RoverView
from sensors.sand.trace_rig import TraceRig
from vehicle.clock import TICK
from vehicle.frames import FloatArray
from vehicle.table_file import open_table


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoverRecording:
    """Images and readings of a rover."""

    directory: Path
    rig: TraceRig
    images: tuple[Path, ...]
    readings: FloatArray  # (n, 2 + 2 wheels) as ``columns``
    slip: FloatArray | None  # (m, 2) time [s] and true slip angle [deg], if known

    def view(self, k: int) -> RoverView | str:
        """The k-th view, or the reason why it can not be used."""
        try:
            image = read_grey_upright(self.images[k])
        except ValueError as error:
            return str(error)
        size = (self.rig.camera.height, self.rig.camera.width)
        if image.shape != size:
            return f"{self.images[k].name} is {image.shape[1]}x{image.shape[0]} px, the rig {size[1]}x{size[0]}"
        row, n = self.readings[k], len(self.rig.wheels)
        return RoverView(
            tick=round(row[0] / TICK),
            image=image,
            heading=math.radians(row[1]),
            wheel_speeds=row[2 : 2 + n].copy(),
            steer=np.radians(row[2 + n :]),
        )


def open_rover_recording(directory: Path, rig_file: Path | None = None) -> RoverRecording:
    """Open the recording in a folder.

    Raises:
        ValueError: one line naming the file that is missing or does not fit.
    """
    if not directory.is_dir():
        raise ValueError(f"{directory} is not a folder")
    folder = directory / IMAGES
    if not folder.is_dir():
        raise ValueError(f"{directory}: the folder {IMAGES} is missing")
    images = tuple(
        sorted(path for path in folder.iterdir() if path.suffix.lower() in (".png", ".jpg", ".jpeg", ".bmp"))
    )
    if not images:
        raise ValueError(f"{folder} contains no images")
    rig = load_rig(rig_file or directory / RIG)
    readings = open_table(directory / READINGS).numbers(columns(rig))
    if len(readings) != len(images):
        raise ValueError(
            f"{directory}: {len(images)} images and {len(readings)} rows in {READINGS}; their numbers must be equal"
        )
    if not np.all(np.diff(readings[:, 0]) >= 0.999 * TICK):
        raise ValueError(f"{directory / READINGS}: time_s must increase by {TICK:g} s or more from row to row")
    slip = open_table(directory / SLIP).numbers(SLIP_COLUMNS) if os.path.lexists(directory / SLIP) else None
    return RoverRecording(directory=directory, rig=rig, images=images, readings=readings, slip=slip)
