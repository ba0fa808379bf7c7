"""Runs as files of messages: MCAP for Foxglove and Lichtblick, and ROS 2 bags.

Messages of an MCAP file have Foxglove's own schemas, so that panels show them without set-up; foxglove-sdk writes it.
A bag has ROS's standard messages; rosbags writes it, which needs no ROS. Both are of the extra ``export``. Topics of a
bag:

| topic | message |
|---|---|
| ``/tf`` | ``tf2_msgs/TFMessage``: frames of all units in ``map`` |
| ``/odom/UNIT`` | ``nav_msgs/Odometry``: pose and velocities of a unit |
| ``/path/hitch`` or ``/path/rover`` | ``nav_msgs/Path``: the whole path, once |
| ``/imu/UNIT`` | ``sensor_msgs/Imu``: yaw rate, without orientation and accelerations |
| ``/joint_states`` | ``sensor_msgs/JointState``: articulation and steer angles |
| ``/signals/NAME`` | ``std_msgs/Float64``: every signal, where it has a value; units: ``/signals_units`` |
| ``/camera/left/image_raw``, ``/camera/right/image_raw`` | ``sensor_msgs/Image``, mono8, as recorded |
| ``/camera/left/camera_info``, ``/camera/right/camera_info`` | ``sensor_msgs/CameraInfo`` |
| ``/offtrack/recording`` | ``std_msgs/String``: the recording's calibration, mounting and true poses as JSON, once |
"""

import json
import math
import os
import shutil
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from estimators.calibration.rectification import Rectifier
from offtrack.exchange.exports.catalogue import ExportedRun
from offtrack.exchange.recordings.bags import FRAMES, RECORDING, SIDES, humble_types
from offtrack.exchange.recordings.camera_files import read_rig
from offtrack.exchange.recordings.stereo_reader import read_projections
from offtrack.exchange.recordings.stereo_sequence import StereoSequence, find_sequence, image_size
from offtrack.reports.film import rgb
from offtrack.reports.player.playback import PALETTE, PlayedRun
from offtrack.reports.run_files import KINDS
from scenarios.extras import import_extra
from scenarios.image_file import read_grey
from scenarios.options.scenario import load_any_scenario
from scenarios.results.log import Log
from scenarios.results.run_directory import check_new_file, replacing
from sensors.camera.rig import CameraModel, StereoCalibration, load_raw_rig
from vehicle.frames import FloatArray, rows_every

WORLD: Final = "W"
_FRAME_PERIOD: Final = 0.02  # of poses [s]
_BETWEEN_POINTS: Final = 0.1  # of drawn paths [m]
_BODY: Final = (0.12, 0.37, 0.66, 0.35)  # red, green, blue, opacity
_NANOSECONDS: Final = 1_000_000_000


class Mcap:
    """An MCAP file.

    Topics: ``/tf`` (frames of all units in W), ``/scene`` (bodies and paths as on the run's page), ``/signals`` (all
    signals of the log by name, one JSON object for each 10 ms; units and meanings in the schema), ``/camera/left`` and
    ``/camera/right`` (PNG images as recorded).
    """

    file: ClassVar = "signals.mcap"
    takes_images: ClassVar = True

    @staticmethod
    def write(run: ExportedRun, path: Path) -> tuple[Path, ...]:
        """Write the file.

        Raises:
            ValueError: one line, if the package is missing, the file exists, or the recording is no stereo recording.
        """
        names = ("foxglove", "foxglove.channels", "foxglove.messages")
        foxglove = import_extra("export", "MCAP needs", *names)
        check_new_file(path)
        log, sequence = run.log, None if run.images is None else find_sequence(run.images, None)
        scenario = load_any_scenario(str(run.scenario))
        kind = KINDS[scenario.vehicle_kind]
        (played,) = kind.playback(kind.rebuilt(scenario, log, {"outcome": ""})).runs
        context = foxglove.Context()
        with replacing(path) as unfinished, foxglove.open_mcap(unfinished, context=context, allow_overwrite=True):
            _write_scene(foxglove, context, played)
            total = len(log) + (0 if sequence is None else 2 * len(sequence.frames))
            for done in _write_log(foxglove, context, played):
                run.progress(done, total, "signals")
            if sequence is not None:
                for count in _write_images(foxglove, context, sequence):
                    run.progress(len(log) + count, total, "images")
        return (path,)


def _frames(run: PlayedRun) -> list[str]:
    """Names of the bodies' frames: those of the units, or rover."""
    return [body.name if body.pose[0] != "x" else "rover" for body in run.bodies]


def _thinned(points: FloatArray) -> FloatArray:
    known = points[np.isfinite(points).all(axis=1)]
    return known if len(known) < 2 else known[rows_every(known, _BETWEEN_POINTS)]


def _write_scene(foxglove: Any, context: Any, run: PlayedRun) -> None:
    m = foxglove.messages

    def at(x: float, y: float, z: float) -> Any:
        return m.Pose(position=m.Vector3(x=x, y=y, z=z), orientation=m.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))

    def coloured(red: float, green: float, blue: float, opacity: float = 1.0) -> Any:
        return m.Color(r=red, g=green, b=blue, a=opacity)

    start = m.Timestamp(sec=0, nsec=0)
    boxes = []
    for body, frame in zip(run.bodies, _frames(run), strict=True):
        low, high = (
            np.append(ends(body.outline, axis=0), z) for ends, z in zip((np.min, np.max), body.heights, strict=True)
        )
        length, width, height = (high - low).tolist()
        box = m.CubePrimitive(
            pose=at(*(0.5 * (low + high)).tolist()),
            size=m.Vector3(x=length, y=width, z=height),
            color=coloured(*_BODY),
        )
        boxes.append(m.SceneEntity(timestamp=start, frame_id=frame, id=frame, frame_locked=True, cubes=[box]))
    strips = [
        m.SceneEntity(
            timestamp=start,
            frame_id=WORLD,
            id=trail.label,
            lines=[
                m.LinePrimitive(
                    type=m.LinePrimitiveLineType.LineStrip,
                    pose=at(0.0, 0.0, 0.0),
                    thickness=0.06,
                    points=[m.Point3(x=x, y=y, z=0.02) for x, y in _thinned(run.trail_points(trail)).tolist()],
                    color=coloured(*(one / 255.0 for one in rgb(PALETTE[trail.colour]))),
                )
            ],
        )
        for trail in run.trails
    ]
    foxglove.channels.SceneUpdateChannel("/scene", context=context).log(
        m.SceneUpdate(entities=[*boxes, *strips]), log_time=0
    )


def _write_log(foxglove: Any, context: Any, run: PlayedRun) -> Iterator[int]:
    """Signals and frames row by row; yields the number of rows written."""
    m, log = foxglove.messages, run.log
    properties = {
        signal.name: {"type": ["number", "null"], "title": f"{signal.description} [{signal.unit}]"}
        for signal in log.signals
    }
    signals = foxglove.Channel(
        "/signals",
        schema={"title": "offtrack.Signals", "type": "object", "properties": properties},
        context=context,
        metadata={f"unit.{signal.name}": signal.unit for signal in log.signals},
    )
    frames = foxglove.channels.FrameTransformsChannel("/tf", context=context)
    poses = [body.poses(log) for body in run.bodies]
    every = max(1, round(_FRAME_PERIOD / float(log["time"][1] - log["time"][0]))) if len(log) > 1 else 1
    for k, (time, row) in enumerate(zip(log["time"].tolist(), log.rows.tolist(), strict=True)):
        stamp = round(time * _NANOSECONDS)
        known = {name: value for name, value in zip(log.names, row, strict=True) if math.isfinite(value)}
        signals.log(known, log_time=stamp)
        if k % every == 0:
            moved = [
                m.FrameTransform(
                    timestamp=m.Timestamp(sec=stamp // _NANOSECONDS, nsec=stamp % _NANOSECONDS),
                    parent_frame_id=WORLD,
                    child_frame_id=frame,
                    translation=m.Vector3(x=x, y=y, z=0.0),
                    rotation=m.Quaternion(x=0.0, y=0.0, z=math.sin(0.5 * psi), w=math.cos(0.5 * psi)),
                )
                for frame, (x, y, psi) in zip(_frames(run), (pose[k].tolist() for pose in poses), strict=True)
            ]
            frames.log(m.FrameTransforms(transforms=moved), log_time=stamp)
        yield k + 1


def _write_images(foxglove: Any, context: Any, sequence: StereoSequence) -> Iterator[int]:
    """Recorded images as they are; yields the number of images written."""
    m = foxglove.messages
    channel = foxglove.channels.CompressedImageChannel
    channels = {side: channel(f"/camera/{side}", context=context) for side in ("left", "right")}
    count = 0
    for frame in sequence.frames:
        stamp = round(frame.time * _NANOSECONDS)
        for side, file in (("left", frame.left), ("right", frame.right)):
            count += 1
            if not file.is_file():
                continue
            image = m.CompressedImage(
                timestamp=m.Timestamp(sec=stamp // _NANOSECONDS, nsec=stamp % _NANOSECONDS),
                frame_id=f"camera_{side}",
                data=file.read_bytes(),
                format=file.suffix.lstrip(".").lower(),
            )
            channels[side].log(image, log_time=stamp)
        yield count


def camera_infos(sequence: StereoSequence) -> dict[str, dict[str, Any]]:
    """Fields of both cameras: size, K (9), D (5), R (9) and P (12), of raw or of rectified images as recorded.

    Raises:
        ValueError: one line, if the recording has no readable calibration.
    """
    size = image_size(sequence)
    rig_file = sequence.directory / "rig.toml"
    if rig_file.is_file() and read_rig(rig_file).raw:
        return _raw(rig_file)
    calibration = read_projections(sequence.directory / "calib.txt", sequence.layout, size)
    K = _matrix(calibration)
    return {
        side: _fields(size, K, np.zeros(5), np.eye(3), _projection(K, shift))
        for side, shift in (("left", 0.0), ("right", calibration.baseline))
    }


def _matrix(calibration: StereoCalibration) -> FloatArray:
    f = calibration.focal_length
    return np.array([[f, 0.0, calibration.cx], [0.0, f, calibration.cy], [0.0, 0.0, 1.0]])


def _raw(path: Path) -> dict[str, dict[str, Any]]:
    raw = load_raw_rig(path)
    rectified = Rectifier(raw).calibration
    K = _matrix(rectified)
    R_left = np.linalg.inv(rectified.X_SC)[:3, :3] @ raw.X_SC[:3, :3]
    return {
        "left": _of_lens(raw.left, R_left, _projection(K, 0.0)),
        "right": _of_lens(raw.right, R_left @ raw.X_ClCr[:3, :3], _projection(K, rectified.baseline)),
    }


def _of_lens(camera: CameraModel, R: FloatArray, P: FloatArray) -> dict[str, Any]:
    return _fields((camera.width, camera.height), camera.matrix, np.array(camera.distortion), R, P)


def _projection(K: FloatArray, baseline: float) -> FloatArray:
    return np.column_stack([K, [-K[0, 0] * baseline, 0.0, 0.0]])


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


MAP: Final = "map"
_POINTS: Final = 2000  # of a path, at most
_CDR: Final = b"\x00\x01\x00\x00"  # begins every message: little-endian
_FILES: Final = ("calib.txt", "rig.toml", "poses.txt")  # of a recording
_UNKNOWN: Final = -1.0  # in the first element of a covariance: the quantity is not measured


class Rosbag2:
    """A ROS 2 bag, which is a folder."""

    file: ClassVar = "rosbag2"
    takes_images: ClassVar = True

    @staticmethod
    def write(run: ExportedRun, path: Path) -> tuple[Path, ...]:
        """Write the folder.

        Raises:
            ValueError: one line, if the package is missing, the folder exists, or the recording is no stereo recording.
        """
        rosbag2 = import_extra("export", "ROS 2 bags need", "rosbags.rosbag2")
        check_new_file(path)
        log, sequence = run.log, None if run.images is None else find_sequence(run.images, None)
        infos = None if sequence is None else camera_infos(sequence)
        units = _units(log)
        # the writer names the file in the folder after the folder, so the unfinished bag has its name already
        unfinished = path.parent / f".{path.name}.{os.getpid()}.unfinished"
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir()
        bag_file = unfinished / path.name
        try:
            with rosbag2.Writer(
                bag_file, version=rosbag2.Writer.VERSION_LATEST, storage_plugin=rosbag2.StoragePlugin.MCAP
            ) as writer:
                bag = _Bag(writer)
                total = len(log) + (0 if sequence is None else len(sequence.frames))
                for done in _write_topics(bag, log, units):
                    run.progress(done, total, "signals")
                if sequence is not None and infos is not None:
                    for count in _write_raw_images(bag, sequence, infos):
                        run.progress(len(log) + count, total, "images")
            bag_file.rename(path)
        finally:
            shutil.rmtree(unfinished, ignore_errors=True)
        return (path,)


def _units(log: Log) -> list[tuple[str, str]]:
    """Name and ending of the signals of every body with a pose; those of a rover have no ending."""
    endings = [name.removeprefix("psi") for name in log.names if name == "psi" or name.startswith("psi_")]
    return [(ending.removeprefix("_") or "rover", ending) for ending in endings]


class _Bag:
    """Topics of a bag and their messages."""

    def __init__(self, writer: Any) -> None:
        self._writer, self._store = writer, humble_types()
        self._connections: dict[str, Any] = {}
        self.types = self._store.types

    def write(self, topic: str, kind: str, stamp: int, message: Any) -> None:
        """Write a message of a kind such as ``nav_msgs/msg/Path``."""
        self.write_raw(topic, kind, stamp, self._store.serialize_cdr(message, kind))

    def write_raw(self, topic: str, kind: str, stamp: int, data: bytes | memoryview) -> None:
        """Write a message that is serialised already."""
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=self._store)
        self._writer.write(self._connections[topic], stamp, data)

    def header(self, stamp: int, frame: str) -> Any:
        """A message's header."""
        time = self.types["builtin_interfaces/msg/Time"](sec=stamp // _NANOSECONDS, nanosec=stamp % _NANOSECONDS)
        return self.types["std_msgs/msg/Header"](stamp=time, frame_id=frame)

    def pose(self, x: float, y: float, psi: float) -> Any:
        """A pose in the plane."""
        point = self.types["geometry_msgs/msg/Point"](x=x, y=y, z=0.0)
        return self.types["geometry_msgs/msg/Pose"](position=point, orientation=self.turn(psi))

    def turn(self, psi: float) -> Any:
        """A rotation about the vertical."""
        return self.types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=math.sin(0.5 * psi), w=math.cos(0.5 * psi))

    def vector(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
        """A vector."""
        return self.types["geometry_msgs/msg/Vector3"](x=x, y=y, z=z)


def _write_topics(bag: _Bag, log: Log, units: list[tuple[str, str]]) -> Iterator[int]:
    """Everything but images, row by row; yields the number of rows written."""
    meanings = {signal.name: {"unit": signal.unit, "meaning": signal.description} for signal in log.signals}
    _write_text(bag, "/signals_units", json.dumps(meanings))
    body = units[-1]
    _write_path(bag, "/path/rover" if body[1] == "" else "/path/hitch", log, body[1])
    every = max(1, round(_FRAME_PERIOD / float(log["time"][1] - log["time"][0]))) if len(log) > 1 else 1
    joints = [name for name in log.names if name.startswith(("articulation_", "steer_")) and "command" not in name]
    angles = np.column_stack([log[name] for name in joints]) if joints else np.zeros((len(log), 0))
    moving = ("x", "y", "psi", "v_x", "v_y", "yaw_rate")
    motions = [np.column_stack([log[f"{name}{ending}"] for name in moving]) for _, ending in units]
    names = [f"/signals/{name}" for name in log.names]
    for k, (time, row) in enumerate(zip(log["time"].tolist(), log.rows.tolist(), strict=True)):
        stamp = round(time * _NANOSECONDS)
        for topic, value in zip(names, row, strict=True):
            if math.isfinite(value):
                bag.write_raw(topic, "std_msgs/msg/Float64", stamp, _CDR + struct.pack("<d", value))
        if k % every == 0:
            _write_state(
                bag, stamp, [(name, *motion[k].tolist()) for (name, _), motion in zip(units, motions, strict=True)]
            )
            known = np.isfinite(angles[k])
            bag.write(
                "/joint_states",
                "sensor_msgs/msg/JointState",
                stamp,
                bag.types["sensor_msgs/msg/JointState"](
                    header=bag.header(stamp, ""),
                    name=[name for name, there in zip(joints, known, strict=True) if there],
                    position=angles[k][known],
                    velocity=np.zeros(0),
                    effort=np.zeros(0),
                ),
            )
        yield k + 1


def _write_state(bag: _Bag, stamp: int, motions: list[tuple[Any, ...]]) -> None:
    types, transforms = bag.types, []
    covariance = np.zeros(36)
    for name, x, y, psi, v_x, v_y, yaw_rate in motions:
        transforms.append(
            types["geometry_msgs/msg/TransformStamped"](
                header=bag.header(stamp, MAP),
                child_frame_id=name,
                transform=types["geometry_msgs/msg/Transform"](translation=bag.vector(x, y), rotation=bag.turn(psi)),
            )
        )
        twist = types["geometry_msgs/msg/Twist"](linear=bag.vector(v_x, v_y), angular=bag.vector(z=yaw_rate))
        odometry = types["nav_msgs/msg/Odometry"](
            header=bag.header(stamp, MAP),
            child_frame_id=name,
            pose=types["geometry_msgs/msg/PoseWithCovariance"](pose=bag.pose(x, y, psi), covariance=covariance),
            twist=types["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=covariance),
        )
        bag.write(f"/odom/{name}", "nav_msgs/msg/Odometry", stamp, odometry)
        unknown = np.zeros(9)
        unknown[0] = _UNKNOWN
        imu = types["sensor_msgs/msg/Imu"](
            header=bag.header(stamp, name),
            orientation=bag.turn(0.0),
            orientation_covariance=unknown,
            angular_velocity=bag.vector(z=yaw_rate),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=bag.vector(),
            linear_acceleration_covariance=unknown,
        )
        bag.write(f"/imu/{name}", "sensor_msgs/msg/Imu", stamp, imu)
    bag.write("/tf", "tf2_msgs/msg/TFMessage", stamp, types["tf2_msgs/msg/TFMessage"](transforms=transforms))


def _write_path(bag: _Bag, topic: str, log: Log, ending: str) -> None:
    rows = np.unique(np.linspace(0, len(log) - 1, min(_POINTS, len(log))).astype(int))
    poses = [
        bag.types["geometry_msgs/msg/PoseStamped"](
            header=bag.header(round(time * _NANOSECONDS), MAP), pose=bag.pose(x, y, psi)
        )
        for time, x, y, psi in zip(
            *(log[name][rows].tolist() for name in ("time", f"x{ending}", f"y{ending}", f"psi{ending}")), strict=True
        )
    ]
    path = bag.types["nav_msgs/msg/Path"](header=bag.header(0, MAP), poses=poses)
    bag.write(topic, "nav_msgs/msg/Path", 0, path)


def _write_text(bag: _Bag, topic: str, text: str) -> None:
    bag.write(topic, "std_msgs/msg/String", 0, bag.types["std_msgs/msg/String"](data=text))


def _write_raw_images(bag: _Bag, sequence: StereoSequence, infos: dict[str, dict[str, Any]]) -> Iterator[int]:
    """Images of both cameras with their calibration; yields the number of frames written."""
    folder = sequence.directory
    texts = {name: (folder / name).read_text(encoding="utf-8") for name in _FILES if (folder / name).is_file()}
    _write_text(bag, RECORDING, json.dumps(texts))
    for count, frame in enumerate(sequence.frames, start=1):
        stamp = round(frame.time * _NANOSECONDS)
        for side, file in zip(SIDES, (frame.left, frame.right), strict=True):
            if not file.is_file():
                continue
            image = read_grey(file)
            header = bag.header(stamp, FRAMES[side])
            message = bag.types["sensor_msgs/msg/Image"](
                header=header,
                height=image.shape[0],
                width=image.shape[1],
                encoding="mono8",
                is_bigendian=0,
                step=image.shape[1],
                data=np.ascontiguousarray(image).reshape(-1),
            )
            bag.write(f"/camera/{side}/image_raw", "sensor_msgs/msg/Image", stamp, message)
            info = bag.types["sensor_msgs/msg/CameraInfo"](
                header=header,
                **infos[side],
                binning_x=0,
                binning_y=0,
                roi=bag.types["sensor_msgs/msg/RegionOfInterest"](
                    x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
                ),
            )
            bag.write(f"/camera/{side}/camera_info", "sensor_msgs/msg/CameraInfo", stamp, info)
        yield count
