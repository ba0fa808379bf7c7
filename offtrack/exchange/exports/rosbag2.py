"""Runs as ROS 2 bags with ROS's standard messages, written by rosbags, which needs no ROS.

Metadata are of version 8, which ROS 2 Humble to Jazzy read as well. Topics:

| topic | message |
|---|---|
| ``/tf``, ``/tf_static`` | ``tf2_msgs/TFMessage``: units in ``map``; optical frames of cameras in their unit |
| ``/odom/UNIT`` | ``nav_msgs/Odometry``: pose and velocities of a unit |
| ``/path/hitch`` or ``/path/rover`` | ``nav_msgs/Path``: the whole path, once |
| ``/imu/UNIT`` | ``sensor_msgs/Imu``: yaw rate, without orientation and accelerations |
| ``/joint_states`` | ``sensor_msgs/JointState``: articulation and steer angles |
| ``/signals/NAME`` | ``std_msgs/Float64``: every signal, where it has a value; units: ``/signals_units`` |
| ``/camera/left/image_raw``, ``/camera/right/image_raw`` | ``sensor_msgs/Image``, mono8; rover: ``/camera/image_raw`` |
| ``…/camera_info`` beside each | ``sensor_msgs/CameraInfo`` |
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

from offtrack.exchange.exports.catalogue import TIME, ExportedRun, plain_names
from offtrack.exchange.exports.scene import MovingBody, RunRecording, moving_bodies, rows_of_poses, run_recording
from offtrack.exchange.recordings.layouts.bag_files import humble_types
from offtrack.exchange.recordings.layouts.bags import RECORDING
from scenarios.extras import import_extra
from scenarios.image_file import read_grey
from scenarios.results.log import Log
from scenarios.results.run_directory import check_new_file

MAP: Final = "map"
_VERSION: Final = 8  # of the metadata: 9 writes the quality of service as a list, which Humble and Jazzy do not read
_POINTS: Final = 2000  # of a path, at most
_CDR: Final = b"\x00\x01\x00\x00"  # begins every message: little-endian
_UNKNOWN: Final = -1.0  # in the first element of a covariance: the quantity is not measured
NANOSECONDS: Final = 1_000_000_000
_MOTION: Final = ("v_x", "v_y", "yaw_rate")


class Rosbag2:
    """A ROS 2 bag, which is a folder."""

    file: ClassVar = "rosbag2"
    takes_images: ClassVar = True

    @staticmethod
    def write(run: ExportedRun, path: Path) -> tuple[Path, ...]:
        """Write the folder.

        Raises:
            ValueError: one line, if the package is missing, the folder exists, or the recording is not the run's.
        """
        rosbag2 = import_extra("export", "ROS 2 bags need", "rosbags.rosbag2")
        check_new_file(path)
        bodies, recording = moving_bodies(run.motion, run.scenario), run_recording(run.images, run.scenario)
        # the writer names the file in the folder after the folder, so the unfinished bag has its name already
        unfinished = path.parent / f".{path.name}.{os.getpid()}.unfinished"
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir()
        bag_file, plugin = unfinished / path.name, rosbag2.StoragePlugin.MCAP
        try:
            with rosbag2.Writer(bag_file, version=_VERSION, storage_plugin=plugin) as writer:
                bag, total = Bag(writer), len(run.log) + recording.count
                _write_fixed(bag, run, bodies, recording)
                for done in _write_rows(bag, run.log, run.motion, bodies):
                    run.progress(done, total, "signals")
                for count in _write_images(bag, recording):
                    run.progress(len(run.log) + count, total, "images")
            bag_file.rename(path)
        finally:
            shutil.rmtree(unfinished, ignore_errors=True)
        return (path,)


def _write_fixed(bag: "Bag", run: ExportedRun, bodies: list[MovingBody], recording: RunRecording) -> None:
    """What does not change: units, the path, poses of cameras, files of the recording."""
    plain, body = plain_names(run.log.names), bodies[-1]
    meanings = {
        signal.name: {"unit": signal.unit, "meaning": signal.description, "topic": f"/signals/{plain[signal.name]}"}
        for signal in run.log.signals
    }
    bag.write("/signals_units", "std_msgs/String", 0, data=json.dumps(meanings))
    rows = np.unique(np.linspace(0, len(run.log) - 1, min(_POINTS, len(run.log))).astype(int))
    poses = [
        bag.make(
            "geometry_msgs/PoseStamped",
            header=bag.header(round(run.log[TIME][row] * NANOSECONDS), MAP),
            pose=bag.pose(body.positions[row].tolist(), body.turns[row].tolist()),
        )
        for row in rows.tolist()
    ]
    topic = "/path/hitch" if body.ending else "/path/rover"
    bag.write(topic, "nav_msgs/Path", 0, header=bag.header(0, MAP), poses=poses)
    if recording.cameras:
        fixed = [
            bag.transform(0, body.frame, camera.frame, camera.X_BC[:3, 3].tolist(), camera.turn)
            for camera in recording.cameras
        ]
        bag.write("/tf_static", "tf2_msgs/TFMessage", 0, transforms=fixed)
        bag.write(RECORDING, "std_msgs/String", 0, data=json.dumps(recording.texts))


def _write_rows(bag: "Bag", log: Log, motion: Log, bodies: list[MovingBody]) -> Iterator[int]:
    """Signals, frames and joints row by row; yields the number of rows written."""
    joints = [name for name in motion.names if name.startswith(("articulation_", "steer_")) and "command" not in name]
    angles = np.column_stack([motion[name] for name in joints]) if joints else np.zeros((len(log), 0))
    speeds = [np.column_stack([motion[f"{name}{body.ending}"] for name in _MOTION]) for body in bodies]
    topics = [f"/signals/{name}" for name in plain_names(log.names).values()]
    every = rows_of_poses(log)
    for k, (time, row) in enumerate(zip(log[TIME].tolist(), log.rows.tolist(), strict=True)):
        stamp = round(time * NANOSECONDS)
        for topic, value in zip(topics, row, strict=True):
            if math.isfinite(value):
                bag.write_raw(topic, "std_msgs/Float64", stamp, _CDR + struct.pack("<d", value))
        if k % every == 0:
            transforms = [
                _write_body(bag, stamp, body, k, speed[k].tolist()) for body, speed in zip(bodies, speeds, strict=True)
            ]
            bag.write("/tf", "tf2_msgs/TFMessage", stamp, transforms=transforms)
            known = np.isfinite(angles[k])
            bag.write(
                "/joint_states",
                "sensor_msgs/JointState",
                stamp,
                header=bag.header(stamp, ""),
                name=[name for name, there in zip(joints, known, strict=True) if there],
                position=angles[k][known],
                velocity=np.zeros(0),
                effort=np.zeros(0),
            )
        yield k + 1


def _write_body(bag: "Bag", stamp: int, body: MovingBody, k: int, speed: list[float]) -> Any:
    """Odometry and yaw rate of a body; returns its frame in the map."""
    (v_x, v_y, yaw_rate), covariance, unknown = speed, np.zeros(36), np.zeros(9)
    unknown[0] = _UNKNOWN
    position, turn = body.positions[k].tolist(), body.turns[k].tolist()
    twist = bag.make("geometry_msgs/Twist", linear=bag.vector(v_x, v_y), angular=bag.vector(z=yaw_rate))
    bag.write(
        f"/odom/{body.frame}",
        "nav_msgs/Odometry",
        stamp,
        header=bag.header(stamp, MAP),
        child_frame_id=body.frame,
        pose=bag.make("geometry_msgs/PoseWithCovariance", pose=bag.pose(position, turn), covariance=covariance),
        twist=bag.make("geometry_msgs/TwistWithCovariance", twist=twist, covariance=covariance),
    )
    bag.write(
        f"/imu/{body.frame}",
        "sensor_msgs/Imu",
        stamp,
        header=bag.header(stamp, body.frame),
        orientation=bag.turn([0.0, 0.0, 0.0, 1.0]),
        orientation_covariance=unknown,
        angular_velocity=bag.vector(z=yaw_rate),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=bag.vector(),
        linear_acceleration_covariance=unknown,
    )
    return bag.transform(stamp, MAP, body.frame, position, turn)


def _write_images(bag: "Bag", recording: RunRecording) -> Iterator[int]:
    """Images of all cameras with their calibration, in the order of their times; yields the number written."""
    roi = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    for count, (time, file, camera) in enumerate(recording.images(), start=1):
        stamp, image = round(time * NANOSECONDS), read_grey(file)
        header = bag.header(stamp, camera.frame)
        height, width = image.shape
        bag.write(
            f"{camera.topic}/image_raw",
            "sensor_msgs/Image",
            stamp,
            header=header,
            height=height,
            width=width,
            encoding="mono8",
            is_bigendian=0,
            step=width,
            data=np.ascontiguousarray(image).reshape(-1),
        )
        bag.write(
            f"{camera.topic}/camera_info",
            "sensor_msgs/CameraInfo",
            stamp,
            header=header,
            **camera.info,
            binning_x=0,
            binning_y=0,
            roi=bag.make("sensor_msgs/RegionOfInterest", **roi),
        )
        yield count


class Bag:
    """Topics of a bag and their messages."""

    def __init__(self, writer: Any) -> None:
        self._writer, self._store = writer, humble_types()
        self._connections: dict[str, Any] = {}

    def make(self, kind: str, **fields: Any) -> Any:
        """A message of a kind such as ``nav_msgs/Path``."""
        return self._store.types[kind.replace("/", "/msg/")](**fields)

    def write(self, topic: str, kind: str, stamp: int, **fields: Any) -> None:
        """Write a message of a kind."""
        message = self.make(kind, **fields)
        self.write_raw(topic, kind, stamp, self._store.serialize_cdr(message, message.__msgtype__))

    def write_raw(self, topic: str, kind: str, stamp: int, data: bytes | memoryview) -> None:
        """Write a message that is serialised already; those of ``/tf_static`` are kept for late subscribers."""
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic,
                kind.replace("/", "/msg/"),
                typestore=self._store,
                offered_qos_profiles=[_latched()] if topic == "/tf_static" else [],
            )
        self._writer.write(self._connections[topic], stamp, data)

    def header(self, stamp: int, frame: str) -> Any:
        """A message's header."""
        time = self.make("builtin_interfaces/Time", sec=stamp // NANOSECONDS, nanosec=stamp % NANOSECONDS)
        return self.make("std_msgs/Header", stamp=time, frame_id=frame)

    def pose(self, position: list[float], turn: list[float]) -> Any:
        """A pose by its position and its quaternion x, y, z, w."""
        point = self.make("geometry_msgs/Point", **dict(zip("xyz", position, strict=True)))
        return self.make("geometry_msgs/Pose", position=point, orientation=self.turn(turn))

    def turn(self, turn: list[float]) -> Any:
        """A quaternion x, y, z, w."""
        return self.make("geometry_msgs/Quaternion", **dict(zip("xyzw", turn, strict=True)))

    def vector(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
        """A vector."""
        return self.make("geometry_msgs/Vector3", x=x, y=y, z=z)

    def transform(self, stamp: int, parent: str, child: str, position: list[float], turn: list[float]) -> Any:
        """A frame in another."""
        moved = self.make("geometry_msgs/Transform", translation=self.vector(*position), rotation=self.turn(turn))
        header = self.header(stamp, parent)
        return self.make("geometry_msgs/TransformStamped", header=header, child_frame_id=child, transform=moved)


def _latched() -> Any:
    of = import_extra("export", "ROS 2 bags need", "rosbags.interfaces")
    never = of.QosTime(2147483647, 4294967295)
    reliable, latched = of.QosReliability.RELIABLE, of.QosDurability.TRANSIENT_LOCAL
    return of.Qos(of.QosHistory.KEEP_LAST, 1, reliable, latched, never, never, of.QosLiveliness.AUTOMATIC, never, False)
