"""Where bodies and cameras are over time, for formats of messages: full poses on the ground of the run, and cameras.

Poses are those of a unit's body: position of its frame on the ground, yaw, and the pitch and roll of the log; a rover's
follow from the ground below its wheels and their sinkage. The heave of a body on its springs, some millimetres, is not
in the log and left out.
"""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from estimators.calibration.rectification import Rectifier
from offtrack.exchange.exports.catalogue import TIME, plain_names
from offtrack.exchange.recordings.calibrations.kitti import read_projections
from offtrack.exchange.recordings.camera_files import read_rig
from offtrack.exchange.recordings.layouts.bag_topics import SIDES
from offtrack.exchange.recordings.layouts.folders import find_sequence
from offtrack.exchange.recordings.stereo_sequence import StereoSequence, image_size
from offtrack.exchange.recordings.writers import open_rover_recording
from scenarios.assembly.adapters import course_of, vehicle_of
from scenarios.assembly.rover_run import terrain_of
from scenarios.assembly.trailer_run import opened_ground
from scenarios.image_file import read_grey
from scenarios.options.scenario import RoverScenario, Scenario, load_any_scenario
from scenarios.results.log import Log
from sensors.camera.rig import CameraModel, StereoCalibration, load_raw_rig
from vehicle.foundation.user_file import FileKind, read_json
from vehicle.frames import FloatArray
from vehicle.rover.description import load_rover

_FRAME_PERIOD: Final = 0.02  # of poses [s]
_FILES: Final = ("calib.txt", "rig.toml", "poses.txt", "readings.csv", "slip.csv")  # of a recording


class MovingBody(NamedTuple):
    """A unit or a rover over time."""

    frame: str  # its name in letters that every format takes
    ending: str  # of its signals
    positions: FloatArray  # (n, 3) in W [m]
    turns: FloatArray  # (n, 4) quaternions x, y, z, w


def moving_bodies(log: Log, scenario_file: Path) -> list[MovingBody]:
    """All bodies with a pose in the log, in its order.

    Raises:
        ValueError: one line, if the scenario cannot be read.
    """
    scenario = load_any_scenario(str(scenario_file))
    endings = [name.removeprefix("psi") for name in log.names if name == "psi" or name.startswith("psi_")]
    frames = plain_names(ending.removeprefix("_") or "rover" for ending in endings).values()
    if isinstance(scenario, Scenario):  # no seed changes the smooth ground
        ground, _ = opened_ground(scenario, course_of(scenario, vehicle_of(scenario)), 0)
    bodies = []
    for frame, ending in zip(frames, endings, strict=True):
        x, y, psi = (log[f"{quantity}{ending}"] for quantity in ("x", "y", "psi"))
        if isinstance(scenario, Scenario):
            tilt = (f"{angle}{ending}" for angle in ("pitch", "roll"))
            z, pitch, roll = ground.height(x, y), *(log[one] if one in log else np.zeros(len(log)) for one in tilt)
        else:
            z, pitch, roll = _rover_attitude(scenario, log)
        turns = Rotation.from_euler("ZYX", np.column_stack([psi, pitch, roll])).as_quat()
        bodies.append(MovingBody(frame, ending, np.column_stack([x, y, z]), turns))
    return bodies


def _rover_attitude(scenario: RoverScenario, log: Log) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Height [m], pitch and roll [rad] (n,) of the plane nearest to the lowest points of the wheels."""
    wheels = load_rover(scenario.vehicle).places
    c, s = np.cos(log["psi"])[:, None], np.sin(log["psi"])[:, None]
    places = np.array([[wheel.x, wheel.y] for wheel in wheels])
    x, y = (log[axis][:, None] + a * places[:, 0] + b * places[:, 1] for axis, a, b in (("x", c, -s), ("y", s, c)))
    lowest = terrain_of(scenario.surface).height(x, y) - np.column_stack([log[f"sinkage_{w.name}"] for w in wheels])
    z, forward, left = (lowest @ np.linalg.pinv(np.column_stack([np.ones(len(places)), places])).T).T
    return z, -np.arctan(forward), np.arctan(left * np.cos(np.arctan(forward)))


def rows_of_poses(log: Log) -> int:
    """Every which row of a log has poses in the file."""
    return max(1, round(_FRAME_PERIOD / float(log[TIME][1] - log[TIME][0]))) if len(log) > 1 else 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedCamera:
    """A camera of a recording."""

    topic: str  # part of a topic: /camera or /camera/left
    frame: str  # optical: x right, y down, z ahead
    X_BC: FloatArray  # (4, 4) its pose in the body that carries it
    info: dict[str, Any]  # width, height, distortion_model, d (5), k (9), r (9), p (12)
    times: tuple[float, ...]  # [s]
    files: tuple[Path, ...]  # its images

    @property
    def turn(self) -> list[float]:
        """Its attitude in the body as a quaternion x, y, z, w."""
        quaternion: list[float] = Rotation.from_matrix(self.X_BC[:3, :3]).as_quat().tolist()
        return quaternion


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RunRecording:
    """Images that a run recorded."""

    cameras: tuple[RecordedCamera, ...]
    texts: dict[str, str]  # the recording's other files by name

    def images(self) -> Iterator[tuple[float, Path, RecordedCamera]]:
        """Time [s] and file of all images, those of a capture together, with their camera."""
        for k, images in enumerate(zip(*(camera.files for camera in self.cameras), strict=True)):
            for file, camera in zip(images, self.cameras, strict=True):
                yield camera.times[k], file, camera

    @property
    def count(self) -> int:
        """Number of images."""
        return sum(len(camera.files) for camera in self.cameras)


def run_recording(folder: Path | None, scenario_file: Path) -> RunRecording:
    """The recording in a folder, which must be that of the run; without a folder one without cameras.

    Raises:
        ValueError: one line, if it cannot be read, or its images are not those of the run.
    """
    if folder is None:
        return RunRecording(cameras=(), texts={})
    is_rover = isinstance(load_any_scenario(str(scenario_file)), RoverScenario)
    texts = {name: (folder / name).read_text(encoding="utf-8") for name in _FILES if (folder / name).is_file()}
    cameras = _rover_camera(folder) if is_rover else _stereo_cameras(find_sequence(folder, None))
    recording = RunRecording(cameras=cameras, texts=texts)
    digest = hashlib.sha256()
    for _, file, _ in recording.images():
        digest.update(np.ascontiguousarray(read_grey(file)).data if file.is_file() else b"missing")
    manifest = read_json(scenario_file.parent / "manifest.json", FileKind.RECORD)
    if digest.hexdigest() != manifest.get("recording_sha256", manifest.get("frames_sha256")):
        raise ValueError(
            f"--images {folder}: its images are not those of the run {scenario_file.parent}, by their hash in its "
            "manifest.json: name the folder that the same run recorded (--record)"
        )
    return recording


def _rover_camera(folder: Path) -> tuple[RecordedCamera, ...]:
    recording = open_rover_recording(folder)
    camera = recording.rig.camera
    return (
        RecordedCamera(
            topic="/camera",
            frame="camera",
            X_BC=recording.rig.X_RC,
            info=_of_lens(camera, np.eye(3), np.column_stack([camera.matrix, np.zeros(3)])),
            times=tuple(recording.readings[:, 0].tolist()),
            files=recording.images,
        ),
    )


def _stereo_cameras(sequence: StereoSequence) -> tuple[RecordedCamera, ...]:
    """Both cameras, of raw or of rectified images as recorded."""
    rig_file = sequence.directory / "rig.toml"
    rig = read_rig(rig_file)
    X_SCl = np.eye(4) if rig.X_SC is None else rig.X_SC
    if rig.raw:
        raw = load_raw_rig(rig_file)
        rectified, X_ClCr = Rectifier(raw).calibration, raw.X_ClCr
        R_left = np.linalg.inv(rectified.X_SC)[:3, :3] @ raw.X_SC[:3, :3]
        infos = [
            _of_lens(raw.left, R_left, _projection(rectified, 0.0)),
            _of_lens(raw.right, R_left @ X_ClCr[:3, :3], _projection(rectified, rectified.baseline)),
        ]
    else:
        size = image_size(sequence)
        pair = read_projections(sequence.directory / "calib.txt", sequence.folders, size)
        X_ClCr = pair.X_ClCr
        projections = [_projection(pair, shift) for shift in (0.0, pair.baseline)]
        infos = [_fields(size, P[:, :3], np.zeros(5), np.eye(3), P) for P in projections]
    poses = X_SCl, X_SCl @ X_ClCr
    files = zip(*((frame.left, frame.right) for frame in sequence.frames), strict=True)
    return tuple(
        RecordedCamera(
            topic=f"/camera/{side}",
            frame=f"camera_{side}",
            X_BC=pose,
            info=info,
            times=tuple(frame.time for frame in sequence.frames),
            files=images,
        )
        for side, pose, info, images in zip(SIDES, poses, infos, files, strict=True)
    )


def _projection(pair: StereoCalibration, shift: float) -> FloatArray:
    f = pair.focal_length
    return np.array([[f, 0.0, pair.cx, -f * shift], [0.0, f, pair.cy, 0.0], [0.0, 0.0, 1.0, 0.0]])


def _of_lens(camera: CameraModel, R: FloatArray, P: FloatArray) -> dict[str, Any]:
    return _fields((camera.width, camera.height), camera.matrix, np.array(camera.distortion), R, P)


def _fields(size: tuple[int, int], K: FloatArray, D: FloatArray, R: FloatArray, P: FloatArray) -> dict[str, Any]:
    return {
        "width": size[0],
        "height": size[1],
        "distortion_model": "plumb_bob",
        "d": D.astype(np.float64),
        "k": K.astype(np.float64).ravel(),
        "r": R.astype(np.float64).ravel(),
        "p": P.astype(np.float64).ravel(),
    }
