"""A rover's recording on disk: ground images, a table of readings, and the calibration of the camera.

``images/000000.png`` …, ``readings.csv`` (time_s, heading_deg, four wheel speeds in rad/s, four steer angles in deg),
``rig.toml``, and where it is known ``slip.csv`` (time_s, slip_deg) to compare with.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final

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
from vehicle.rover.command import WHEELS
from vehicle.rover.truth import RoverTruth

IMAGES, READINGS, RIG, SLIP = "images", "readings.csv", "rig.toml", "slip.csv"
COLUMNS: Final = (
    "time_s",
    "heading_deg",
    *(f"wheel_speed_{wheel}" for wheel in WHEELS),
    *(f"steer_deg_{wheel}" for wheel in WHEELS),
)
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
        (self._growing / READINGS).write_text(",".join(COLUMNS) + "\n", encoding="utf-8")
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
            "wheelbase": rig.wheelbase,
            "tread": rig.tread,
            "camera": {**camera, "distortion": list(c.distortion)},
        }
    )


def load_rig(path: Path) -> TraceRig:
    """The rig in a TOML file.

    Raises:
        ValueError: one line naming file and key.
    """
    table = read_toml(path)
    try:
        camera = dict(table["camera"])
        camera["distortion"] = tuple(camera.get("distortion", (0.0,) * 5))
        numbers = {name: float(table[name]) for name in ("wheel_radius", "wheel_width", "wheelbase", "tread")}
        X_RC = np.array(table["X_RC"], dtype=np.float64)
        x, y = (float(value) for value in table["wheel"])
        if X_RC.shape != (4, 4) or not np.allclose(X_RC[:3, :3] @ X_RC[:3, :3].T, np.eye(3), atol=1e-6):
            raise ValueError("X_RC must be the 4 x 4 pose of the camera in the rover")
        return TraceRig(camera=CameraModel(**camera), X_RC=X_RC, wheel=(x, y), **numbers)
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
    readings: FloatArray  # (n, 10) as COLUMNS
    slip: FloatArray | None  # (m, 2) time [s] and slip angle [deg], if it is known

    def view(self, k: int) -> RoverView | str:
        """The k-th view, or in words why it can not be used."""
        image = cv2.imread(str(self.images[k]), cv2.IMREAD_GRAYSCALE) if self.images[k].is_file() else None
        size = (self.rig.camera.height, self.rig.camera.width)
        if image is None:
            return f"{self.images[k].name} is missing or no image"
        if image.shape != size:
            return f"{self.images[k].name} is {image.shape[1]}x{image.shape[0]} px, the rig {size[1]}x{size[0]}"
        row = self.readings[k]
        grey: GreyImage = np.asarray(image, dtype=np.uint8)
        return RoverView(
            tick=round(row[0] / TICK),
            image=grey,
            heading=math.radians(row[1]),
            wheel_speeds=row[2:6].copy(),
            steer=np.radians(row[6:10]),
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
    readings = _table(directory / READINGS, COLUMNS)
    if len(readings) != len(images):
        raise ValueError(f"{directory}: {len(images)} images and {len(readings)} rows in {READINGS}: must be as many")
    if not np.all(np.diff(readings[:, 0]) > 0.0):
        raise ValueError(f"{directory / READINGS}: time_s must grow from row to row")
    slip = _table(directory / SLIP, ("time_s", "slip_deg")) if (directory / SLIP).is_file() else None
    rig = load_rig(rig_file or directory / RIG)
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
