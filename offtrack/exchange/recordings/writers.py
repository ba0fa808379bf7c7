"""Writers of stereo and rover recordings, and the reader of a rover's.

``image_0`` and ``image_1`` hold the left and right grey images, ``calib.txt`` the projection matrices, ``times.txt``
the capture times, ``poses.txt`` the true pose of the left camera relative to the first frame. ``rig.toml`` adds the
camera's pose on the trailer and the trailer's follow point. KITTI's projections can not describe raw images: for these
``rig.toml`` contains the whole calibration, and there is no ``calib.txt``.

A rover's recording has ``images/000000.png`` …, ``readings.csv`` (time_s, heading_deg, each wheel's speed in rad/s,
each wheel's steer angle in deg), ``rig.toml``, and where the true slip is known ``slip.csv`` (time_s, slip_deg).
"""

import math
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Self

import cv2
import numpy as np
import tomli_w
from numpy.typing import NDArray

from scenarios.image_file import images_in, read_grey_upright
from scenarios.results.run_directory import appearing_at_once, mark_interrupted
from sensors.camera.rig import CameraModel, RawStereoRig, StereoCalibration
from sensors.messages import RoverView, StereoFrame
from sensors.sand.trace_rig import TraceRig
from vehicle.clock import TICK
from vehicle.foundation.data_file import Column, open_table
from vehicle.foundation.user_file import FileKind, read_toml, shown
from vehicle.frames import FloatArray, inverse, is_rotation
from vehicle.rover.command import WheelPlace, corner_wheels
from vehicle.rover.truth import RoverTruth

if TYPE_CHECKING:  # the whole simulator
    from scenarios.assembly.trailer_run import Assembly

_LONGEST: Final = 100.0  # length on a rover [m]
IMAGES, READINGS, RIG, SLIP = "images", "readings.csv", "rig.toml", "slip.csv"
TIME: Final = Column("time_s", 1e10, "s")
SLIP_COLUMNS: Final = (TIME, Column("slip_deg", 180.0, "deg"))


def rig_toml(rig: TraceRig) -> str:
    """The rig as TOML, numbers exact to the last bit."""
    camera = {name: getattr(rig.camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    return tomli_w.dumps(
        {
            "X_RC": rig.X_RC.tolist(),
            "wheel": list(rig.wheel),
            "wheel_radius": rig.wheel_radius,
            "wheel_width": rig.wheel_width,
            **_wheels_table(rig.wheels),
            "camera": {**camera, "distortion": list(rig.camera.distortion)},
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
    upside_down: bool = False  # the camera is turned by half a turn about its optical axis

    def view(self, k: int) -> RoverView | str:
        """The k-th view, or the reason why it can not be used."""
        try:
            image = read_grey_upright(self.images[k])
            if self.upside_down:
                image = np.ascontiguousarray(image[::-1, ::-1])
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


def open_rover_recording(directory: Path, rig_file: Path | None = None, *, upside_down: bool = False) -> RoverRecording:
    """Open the recording in a folder; images of a camera that is ``upside_down`` are turned.

    Raises:
        ValueError: one line naming the file that is missing or does not fit.
    """
    if not directory.is_dir():
        raise ValueError(f"{directory} is not a folder")
    folder = directory / IMAGES
    if not folder.is_dir():
        raise ValueError(f"{directory}: the folder {IMAGES} is missing")
    images = tuple(images_in(folder))
    rig = load_rig(rig_file or directory / RIG)
    readings = open_table(directory / READINGS).numbers(columns(rig))
    if len(readings) != len(images):
        raise ValueError(
            f"{directory}: {len(images)} images and {len(readings)} rows in {READINGS}; their numbers must be equal"
        )
    if not np.all(np.diff(readings[:, 0]) >= 0.999 * TICK):
        raise ValueError(f"{directory / READINGS}: time_s must increase by {TICK:g} s or more from row to row")
    slip = open_table(directory / SLIP).numbers(SLIP_COLUMNS) if os.path.lexists(directory / SLIP) else None
    return RoverRecording(
        directory=directory, rig=rig, images=images, readings=readings, slip=slip, upside_down=upside_down
    )


class RecordingFolder:
    """Folder of a recording, which appears at the end of the block, or not at all after an error.

    Raises:
        ValueError: when the block is entered, if the directory can not be made or contains other files.
    """

    def __init__(self, directory: Path) -> None:
        self._appearing = appearing_at_once(directory)

    def __enter__(self) -> Self:
        self._folder = self._appearing.__enter__()
        self._begin()
        return self

    def _begin(self) -> None:
        """Write what does not change during the recording."""

    def end(self) -> None:
        """End the recording; it may be replaced until its run is written: see `mark_complete`."""
        mark_interrupted(self._folder)

    def note(self, name: str, line: str) -> None:
        """Append a line to a file of the recording, or to one besides these."""
        with (self._folder / name).open("a", encoding="utf-8") as file:
            file.write(line + "\n")

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._appearing.__exit__(kind, error, trace)


_FAST_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]  # noise compresses no better at 9, only ten times more slowly


def write_images(images: Mapping[Path, NDArray[Any]]) -> None:
    """Write grey images, all or none of them.

    Raises:
        OSError: if they could not be written.
    """
    try:
        for path, image in images.items():
            path.write_bytes(cv2.imencode(path.suffix, image, _FAST_PNG if path.suffix == ".png" else [])[1].tobytes())
    except OSError:
        for path in images:
            path.unlink(missing_ok=True)
        raise


class RecordingWriter(RecordingFolder):
    """Writes a recording frame by frame."""

    def __init__(
        self,
        directory: Path,
        calibration: StereoCalibration | RawStereoRig,
        follow_distance: float,
        roll_axis_height: float = 0.0,
    ) -> None:
        super().__init__(directory)
        self._calibration, self._distances = calibration, (follow_distance, roll_axis_height)
        self._X_C0W: FloatArray | None = None  # inverse of the first camera pose
        self._count = 0

    def _begin(self) -> None:
        for side in (0, 1):
            (self._folder / f"image_{side}").mkdir()
        if isinstance(self._calibration, StereoCalibration):
            (self._folder / "calib.txt").write_text(calibration_text(self._calibration), encoding="utf-8")
        rig = rig_text(self._calibration, *self._distances)
        (self._folder / "rig.toml").write_text(rig, encoding="utf-8")

    def add(self, frame: StereoFrame, X_WB: FloatArray) -> None:
        """Append a stereo pair and the true pose (4, 4) of the trailer body at its capture."""
        X_WC = X_WB @ self._calibration.X_SC
        if self._X_C0W is None:
            self._X_C0W = inverse(X_WC)
        pair = {f"image_{side}": image for side, image in enumerate((frame.left, frame.right))}
        write_images({self._folder / name / f"{self._count:06d}.png": image for name, image in pair.items()})
        self.note("times.txt", f"{frame.tick * TICK:.3f}")
        self.note("poses.txt", _numbers((self._X_C0W @ X_WC)[:3]))
        self._count += 1


def calibration_text(calibration: StereoCalibration) -> str:
    """Projection matrices P0 and P1, 3x4 row by row, as in KITTI's calib.txt."""
    c = calibration
    P0 = np.array([[c.focal_length, 0.0, c.cx, 0.0], [0.0, c.focal_length, c.cy, 0.0], [0.0, 0.0, 1.0, 0.0]])
    P1 = P0.copy()
    P1[0, 3] = -c.focal_length * c.baseline
    return projections_text(P0, P1)


def projections_text(P0: FloatArray, P1: FloatArray) -> str:
    """Lines of a ``calib.txt``, of projections (3, 4)."""
    return f"P0: {_numbers(P0)}\nP1: {_numbers(P1)}\n"


def rig_text(
    calibration: StereoCalibration | RawStereoRig, follow_distance: float, roll_axis_height: float = 0.0
) -> str:
    """The rig as TOML, numbers exact to the last bit."""
    trailer = (
        f"follow_distance = {follow_distance!r}  # hitch to follow point [m]\n"
        f"roll_axis_height = {roll_axis_height!r}  # of the axis about which the trailer's body rolls [m]\n"
        "direction_std_deg = 0.0  # 1 sigma of the camera's direction in the trailer; 0: exact [deg]\n"
    )
    if isinstance(calibration, RawStereoRig):
        return f"{trailer}{calibration.to_toml()}"
    rows = ",\n".join(f"  [{', '.join(repr(float(value)) for value in row)}]" for row in calibration.X_SC)
    return (
        f"baseline = {calibration.baseline!r}  # [m]\n"
        f"{trailer}"
        f"# pose of the left camera (x right, y down, z ahead) in the trailer (origin: hitch on the ground) [m]\n"
        f"X_SC = [\n{rows},\n]\n"
    )


def _numbers(matrix: FloatArray) -> str:
    return " ".join(f"{value:.12e}" for value in matrix.ravel())


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
        write_images({self._folder / IMAGES / f"{self._count:06d}.png": view.image})
        self.note(READINGS, ",".join([time, *(f"{number:.17g}" for number in numbers)]))
        self.note(SLIP, f"{time},{math.degrees(truth.slip_angle):.9g}")
        self._count += 1


def _of_trailer(directory: Path, parts: "Assembly") -> RecordingWriter:
    if parts.cameras is None:
        raise ValueError("there is no camera to record")
    last = parts.trailers[-1]
    return RecordingWriter(directory, parts.cameras.calibrated, last.geometry.follow_distance, last.path_height)


_WRITERS: Final[dict[str, Callable[[Path, Any], RecordingFolder]]] = {
    "trailer": _of_trailer,
    "rover": lambda directory, parts: RoverRecordingWriter(directory, parts.rig),
}


def recording_in(directory: Path) -> Callable[[Any], Any]:
    """What opens the recording of a run in a directory: call it with the assembled parts.

    Raises:
        ValueError: when it is called, one line, if the parts have no camera.
    """
    return lambda parts: _WRITERS[parts.scenario.vehicle_kind](directory, parts)
