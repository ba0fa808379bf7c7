"""A rover's recording on disk: ground images, a table of readings, and the calibration of the camera.

``images/000000.png`` …, ``readings.csv`` (time_s, heading_deg, each wheel's speed in rad/s, each wheel's
steer angle in deg),
``rig.toml``, and where it is known ``slip.csv`` (time_s, slip_deg) to compare with.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import cv2
import numpy as np
import tomli_w

from scenarios.results.run import check_run_directory
from sensors.camera.lens import CameraModel
from sensors.messages import GreyImage, RoverView
from sensors.sand.trace_rig import TraceRig
from vehicle.clock import TICK
from vehicle.frames import FloatArray
from vehicle.parameter_file import read_toml
from vehicle.rover.command import WheelPlace, corner_wheels
from vehicle.rover.truth import RoverTruth

IMAGES, READINGS, RIG, SLIP = "images", "readings.csv", "rig.toml", "slip.csv"
_FAST_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]


class RoverRecordingWriter:
    """Writes a recording view by view under a working name; it gets its own at the end."""

    def __init__(self, directory: Path, rig: TraceRig) -> None:
        check_run_directory(directory)
        self._directory = directory.resolve()
        self._growing = self._directory.with_name(f".{self._directory.name}.unfinished")
        self._rig, self._count = rig, 0

    def __enter__(self) -> RoverRecordingWriter:
        (self._growing / IMAGES).mkdir(parents=True)
        (self._growing / RIG).write_text(rig_toml(self._rig), encoding="utf-8")
        (self._growing / READINGS).write_text(",".join(columns(self._rig)) + "\n", encoding="utf-8")
        (self._growing / SLIP).write_text("time_s,slip_deg\n", encoding="utf-8")
        return self

    def add(self, view: RoverView, truth: RoverTruth) -> None:
        """One view more, and the slip that was true."""
        path = self._growing / IMAGES / f"{self._count:06d}.png"
        if not cv2.imwrite(str(path), view.image, _FAST_PNG):
            raise OSError(f"could not write {path}: is the disk full?")
        time = f"{view.tick * TICK:.3f}"
        steer = np.degrees(view.steer)
        numbers = [math.degrees(view.heading), *view.wheel_speeds.tolist(), *steer.tolist()]
        self._append(READINGS, ",".join([time, *(f"{number:.9g}" for number in numbers)]))
        self._append(SLIP, f"{time},{math.degrees(truth.slip_angle):.9g}")
        self._count += 1

    def _append(self, name: str, line: str) -> None:
        with (self._growing / name).open("a", encoding="utf-8") as file:
            file.write(line + "\n")

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            if self._directory.is_dir():
                self._directory.rmdir()  # it was empty, or it would have been refused
            self._growing.rename(self._directory)


def rig_toml(rig: TraceRig) -> str:
    """The rig as TOML, numbers to the last bit."""
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


def columns(rig: TraceRig) -> tuple[str, ...]:
    """Columns of ``readings.csv``."""
    names = [wheel.name for wheel in rig.wheels]
    return (
        "time_s",
        "heading_deg",
        *(f"wheel_speed_{name}" for name in names),
        *(f"steer_deg_{name}" for name in names),
    )


def _wheels_table(wheels: tuple[WheelPlace, ...]) -> dict[str, Any]:
    """The wheels in ``rig.toml``: ``wheelbase`` and ``tread`` of four at the corners, else a list."""
    wheelbase, tread = 2.0 * wheels[0].x, 2.0 * wheels[0].y
    if wheels == corner_wheels(wheelbase, tread):
        return {"wheelbase": wheelbase, "tread": tread}
    return {"wheels": [wheel._asdict() for wheel in wheels]}


def _wheels(table: dict[str, Any]) -> tuple[WheelPlace, ...]:
    if "wheels" not in table:
        return corner_wheels(float(table["wheelbase"]), float(table["tread"]))
    return tuple(WheelPlace(str(one["name"]), float(one["x"]), float(one["y"])) for one in table["wheels"])


def load_rig(path: Path) -> TraceRig:
    """The rig in a TOML file.

    Raises:
        ValueError: one line naming file and key.
    """
    table = read_toml(path)
    try:
        camera = dict(table["camera"])
        camera["distortion"] = tuple(camera.get("distortion", (0.0,) * 5))
        numbers = {name: float(table[name]) for name in ("wheel_radius", "wheel_width")}
        X_RC = np.array(table["X_RC"], dtype=np.float64)
        x, y = (float(value) for value in table["wheel"])
        if X_RC.shape != (4, 4) or not np.allclose(X_RC[:3, :3] @ X_RC[:3, :3].T, np.eye(3), atol=1e-6):
            raise ValueError("X_RC must be the 4 x 4 pose of the camera in the rover")
        wheels = _wheels(table)
        watched = min(range(len(wheels)), key=lambda k: math.dist((x, y), wheels[k][1:]))
        return TraceRig(
            camera=CameraModel(**camera), X_RC=X_RC, wheel=(x, y), wheels=wheels, watched=watched, **numbers
        )
    except KeyError as error:
        raise ValueError(f"{path}: {error.args[0]} is missing") from None
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoverRecording:
    """A recording that can be estimated from."""

    directory: Path
    rig: TraceRig
    images: tuple[Path, ...]
    readings: FloatArray  # (n, 2 + 2 wheels) as ``columns``
    slip: FloatArray | None  # (m, 2) time [s] and slip angle [deg], if it is known

    def view(self, k: int) -> RoverView | str:
        """The k-th view, or in words why it can not be used."""
        image = cv2.imread(str(self.images[k]), cv2.IMREAD_GRAYSCALE) if self.images[k].is_file() else None
        size = (self.rig.camera.height, self.rig.camera.width)
        if image is None:
            return f"{self.images[k].name} is missing or no image"
        if image.shape != size:
            return f"{self.images[k].name} is {image.shape[1]}x{image.shape[0]} px, the rig {size[1]}x{size[0]}"
        row, n = self.readings[k], len(self.rig.wheels)
        grey: GreyImage = np.asarray(image, dtype=np.uint8)
        return RoverView(
            tick=round(row[0] / TICK),
            image=grey,
            heading=math.radians(row[1]),
            wheel_speeds=row[2 : 2 + n].copy(),
            steer=np.radians(row[2 + n :]),
        )


def open_rover_recording(directory: Path, rig_file: Path | None = None) -> RoverRecording:
    """The recording in a folder.

    Raises:
        ValueError: one line, for whatever is missing or does not fit.
    """
    if not directory.is_dir():
        raise ValueError(f"{directory} is no folder")
    folder = directory / IMAGES
    if not folder.is_dir():
        raise ValueError(f"{directory}: folder {IMAGES} is missing")
    images = tuple(
        sorted(path for path in folder.iterdir() if path.suffix.lower() in (".png", ".jpg", ".jpeg", ".bmp"))
    )
    if not images:
        raise ValueError(f"{folder}: holds no images")
    rig = load_rig(rig_file or directory / RIG)
    readings = _table(directory / READINGS, columns(rig))
    if len(readings) != len(images):
        raise ValueError(f"{directory}: {len(images)} images and {len(readings)} rows in {READINGS}: must be as many")
    if not np.all(np.diff(readings[:, 0]) > 0.0):
        raise ValueError(f"{directory / READINGS}: time_s must grow from row to row")
    slip = _table(directory / SLIP, ("time_s", "slip_deg")) if (directory / SLIP).is_file() else None
    return RoverRecording(directory=directory, rig=rig, images=images, readings=readings, slip=slip)


def _table(path: Path, columns: tuple[str, ...]) -> FloatArray:
    """The named columns of a CSV file.

    Raises:
        ValueError: one line, if the file or a column is missing or a value is no number.
    """
    if not path.is_file():
        raise ValueError(f"{path} is missing")
    with path.open(newline="", encoding="utf-8") as file:
        lines: list[dict[str, Any]] = list(csv.DictReader(file))
    table = np.empty((len(lines), len(columns)))
    for number, line in enumerate(lines, start=2):
        for k, column in enumerate(columns):
            try:
                table[number - 2, k] = float(line[column])
            except KeyError:
                raise ValueError(f"{path}: column {column} is missing; expected {', '.join(columns)}") from None
            except (TypeError, ValueError):
                raise ValueError(f"{path}, line {number}: {column} = {line[column]!r} is no number") from None
    if not np.isfinite(table).all():
        raise ValueError(f"{path}: all numbers must be finite")
    return table
