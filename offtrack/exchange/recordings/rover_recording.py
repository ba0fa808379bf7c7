"""A rover's recording: its files, its camera rig as TOML, and their reader.

``images/000000.png`` …, ``readings.csv`` (time_s, heading_deg, each wheel's speed in rad/s, each wheel's steer angle in
deg), ``rig.toml``, and where the true slip is known ``slip.csv`` (time_s, slip_deg).
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import tomli_w

from scenarios.image_file import read_grey_upright
from sensors.camera.rig import CameraModel
from sensors.messages import RoverView
from sensors.sand.trace_rig import TraceRig
from vehicle.clock import TICK
from vehicle.foundation.data_file import Column, open_table
from vehicle.foundation.user_file import FileKind, read_toml, shown
from vehicle.frames import FloatArray, is_rotation
from vehicle.rover.command import WheelPlace, corner_wheels

_LONGEST: Final = 100.0  # length on a rover [m]
IMAGES, READINGS, RIG, SLIP = "images", "readings.csv", "rig.toml", "slip.csv"
TIME: Final = Column("time_s", 1e10, "s")
SLIP_COLUMNS: Final = (TIME, Column("slip_deg", 180.0, "deg"))


def rig_toml(rig: TraceRig) -> str:
    """The rig as TOML, numbers exact to the last bit."""
    c = rig.camera
    camera = {"width": c.width, "height": c.height, "fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy}
    return tomli_w.dumps(
        {
            "X_RC": rig.X_RC.tolist(),
            "wheel": list(rig.wheel),
            "wheel_radius": rig.wheel_radius,
            "wheel_width": rig.wheel_width,
            **_wheels_table(rig.wheels),
            "camera": {**camera, "distortion": list(c.distortion)},
        }
    )


def columns(rig: TraceRig) -> tuple[Column, ...]:
    """Columns of ``readings.csv``."""
    names = [wheel.name for wheel in rig.wheels]
    return (
        TIME,
        Column("heading_deg", 1e6, "deg"),
        *(Column(f"wheel_speed_{name}", 1000.0, "rad/s") for name in names),
        *(Column(f"steer_deg_{name}", 360.0, "deg") for name in names),
    )


def header(columns: Iterable[Column]) -> str:
    """First line of a table with these columns."""
    return ",".join(column.name for column in columns) + "\n"


def _wheels_table(wheels: tuple[WheelPlace, ...]) -> dict[str, Any]:
    """Wheels as ``rig.toml`` has them: ``wheelbase`` and ``tread`` of four at the corners, otherwise a list."""
    wheelbase, tread = 2.0 * wheels[0].x, 2.0 * wheels[0].y
    if wheels == corner_wheels(wheelbase, tread):
        return {"wheelbase": wheelbase, "tread": tread}
    return {"wheels": [wheel._asdict() for wheel in wheels]}


def _wheels(table: dict[str, Any]) -> tuple[WheelPlace, ...]:
    if "wheels" not in table:
        return corner_wheels(float(table["wheelbase"]), float(table["tread"]))
    return tuple(WheelPlace(str(one["name"]), float(one["x"]), float(one["y"])) for one in table["wheels"])


def load_rig(path: Path) -> TraceRig:
    """Read a rig from a TOML file.

    Raises:
        ValueError: one line naming file and key.
    """
    table = read_toml(path, FileKind.CALIBRATION)
    try:
        camera = dict(table["camera"])
        camera["distortion"] = tuple(camera.get("distortion", (0.0,) * 5))
        numbers = {name: float(table[name]) for name in ("wheel_radius", "wheel_width")}
        X_RC = np.array(table["X_RC"], dtype=np.float64)
        x, y = (float(value) for value in table["wheel"])
        if X_RC.shape != (4, 4) or not is_rotation(X_RC[:3, :3], 1e-6):
            raise ValueError("X_RC must be the 4 x 4 pose of the camera in the rover")
        wheels = _wheels(table)
        lengths = (*X_RC[:3, 3], x, y, *numbers.values(), *(place for wheel in wheels for place in wheel[1:]))
        if not (all(abs(length) <= _LONGEST for length in lengths) and min(numbers.values()) > 0.0):
            raise ValueError(f"lengths must be at most {_LONGEST:g} m, wheel_radius and wheel_width positive")
        watched = min(range(len(wheels)), key=lambda k: math.dist((x, y), wheels[k][1:]))
        return TraceRig(
            camera=CameraModel(**camera), X_RC=X_RC, wheel=(x, y), wheels=wheels, watched=watched, **numbers
        )
    except KeyError as error:
        raise ValueError(f"{path}: {error.args[0]} is missing") from None
    except (TypeError, ValueError, AttributeError) as error:
        raise ValueError(f"{path}: {shown(str(error))}") from None


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
