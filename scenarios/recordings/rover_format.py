"""Files of a rover's recording: their names, the columns of the readings, and the camera rig as TOML.

``images/000000.png`` …, ``readings.csv`` (time_s, heading_deg, each wheel's speed in rad/s, each wheel's steer angle in
deg), ``rig.toml``, and where the true slip is known ``slip.csv`` (time_s, slip_deg).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import numpy as np
import tomli_w

from sensors.camera.lens import CameraModel
from sensors.sand.trace_rig import TraceRig
from vehicle.frames import is_rotation
from vehicle.parameter_file import read_toml
from vehicle.rover.command import WheelPlace, corner_wheels
from vehicle.table_file import Column
from vehicle.user_file import FileKind, shown

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
