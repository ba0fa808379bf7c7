"""Runs as MCAP files for Foxglove and Lichtblick, with Foxglove's own schemas, written by foxglove-sdk.

Panels show them without set-up. The schema of ``/signals`` keeps to what Lichtblick takes of JSON Schema.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from offtrack.exchange.exports.catalogue import TIME, ExportedRun, plain_names
from offtrack.exchange.exports.scene import MovingBody, RunRecording, moving_bodies, rows_of_poses, run_recording
from offtrack.reports.film import rgb
from offtrack.reports.player.playback import PALETTE, PlayedRun
from offtrack.reports.run_files import KINDS
from scenarios.extras import import_extra
from scenarios.options.scenario import load_any_scenario
from scenarios.results.log import Log
from scenarios.results.run_directory import check_new_file, replacing
from vehicle.frames import FloatArray, rows_every

WORLD: Final = "W"
_BETWEEN_POINTS: Final = 0.1  # of drawn paths [m]
_BODY: Final = (0.12, 0.37, 0.66, 0.35)  # red, green, blue, opacity
_NANOSECONDS: Final = 1_000_000_000


class Mcap:
    """An MCAP file.

    Topics: ``/tf`` (frames of all units in W, and of cameras in their unit), ``/scene`` (bodies and paths as on the
    run's page), ``/signals`` (all signals of the log, one JSON object for each 10 ms without those that have no value;
    meanings in the schema, units and original names in the channel's metadata), ``/camera/left``, ``/camera/right`` or
    a rover's ``/camera`` (PNG images as recorded), each with ``…/calibration``.
    """

    file: ClassVar = "signals.mcap"
    takes_images: ClassVar = True

    @staticmethod
    def write(run: ExportedRun, path: Path) -> tuple[Path, ...]:
        """Write the file.

        Raises:
            ValueError: one line, if the package is missing, the file exists, or the recording is not the run's.
        """
        foxglove = import_extra("export", "MCAP needs", "foxglove", "foxglove.channels", "foxglove.messages")
        check_new_file(path)
        bodies, recording = moving_bodies(run.motion, run.scenario), run_recording(run.images, run.scenario)
        scenario = load_any_scenario(str(run.scenario))
        kind = KINDS[scenario.vehicle_kind]
        (played,) = kind.playback(kind.rebuilt(scenario, run.motion, {"outcome": ""})).runs
        context = foxglove.Context()
        with replacing(path) as unfinished, foxglove.open_mcap(unfinished, context=context, allow_overwrite=True):
            _write_scene(foxglove, context, played, bodies)
            _write_calibration(foxglove, context, recording)
            total = len(run.log) + recording.count
            for done in _write_log(foxglove, context, run.log, bodies, recording):
                run.progress(done, total, "signals")
            for count in _write_images(foxglove, context, recording):
                run.progress(len(run.log) + count, total, "images")
        return (path,)


def _stamp(m: Any, stamp: int) -> Any:
    return m.Timestamp(sec=stamp // _NANOSECONDS, nsec=stamp % _NANOSECONDS)


def _pose(m: Any, position: list[float]) -> Any:
    x, y, z = position
    return m.Pose(position=m.Vector3(x=x, y=y, z=z), orientation=m.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))


def _transform(m: Any, stamp: int, parent: str, child: str, position: list[float], turn: list[float]) -> Any:
    return m.FrameTransform(
        timestamp=_stamp(m, stamp),
        parent_frame_id=parent,
        child_frame_id=child,
        translation=m.Vector3(**dict(zip("xyz", position, strict=True))),
        rotation=m.Quaternion(**dict(zip("xyzw", turn, strict=True))),
    )


def _thinned(points: FloatArray) -> FloatArray:
    known = points[np.isfinite(points).all(axis=1)]
    return known if len(known) < 2 else known[rows_every(known, _BETWEEN_POINTS)]


def _write_scene(foxglove: Any, context: Any, run: PlayedRun, bodies: list[MovingBody]) -> None:
    m = foxglove.messages
    start, entities = _stamp(m, 0), []
    for body, moving in zip(run.bodies, bodies, strict=True):
        low, high = (
            np.append(ends(body.outline, axis=0), z) for ends, z in zip((np.min, np.max), body.heights, strict=True)
        )
        length, width, height = (high - low).tolist()
        box = m.CubePrimitive(
            pose=_pose(m, (0.5 * (low + high)).tolist()),
            size=m.Vector3(x=length, y=width, z=height),
            color=m.Color(**dict(zip("rgba", _BODY, strict=True))),
        )
        frame = moving.frame
        entities.append(m.SceneEntity(timestamp=start, frame_id=frame, id=frame, frame_locked=True, cubes=[box]))
    for trail in run.trails:
        red, green, blue = (one / 255.0 for one in rgb(PALETTE[trail.colour]))
        line = m.LinePrimitive(
            type=m.LinePrimitiveLineType.LineStrip,
            pose=_pose(m, [0.0, 0.0, 0.0]),
            thickness=0.06,
            points=[m.Point3(x=x, y=y, z=0.02) for x, y in _thinned(run.trail_points(trail)).tolist()],
            color=m.Color(r=red, g=green, b=blue, a=1.0),
        )
        entities.append(m.SceneEntity(timestamp=start, frame_id=WORLD, id=trail.label, lines=[line]))
    foxglove.channels.SceneUpdateChannel("/scene", context=context).log(m.SceneUpdate(entities=entities), log_time=0)


def _write_log(
    foxglove: Any, context: Any, log: Log, bodies: list[MovingBody], recording: RunRecording
) -> Iterator[int]:
    """Signals and frames row by row; yields the number of rows written."""
    m, plain = foxglove.messages, plain_names(log.names)
    tf = foxglove.channels.FrameTransformsChannel("/tf", context=context)
    fixed = [  # in every message, so that a viewer that jumps has them
        (bodies[-1].frame, camera.frame, camera.X_BC[:3, 3].tolist(), camera.turn) for camera in recording.cameras
    ]
    properties = {
        plain[signal.name]: {"type": "number", "title": f"{signal.description} [{signal.unit}]"}
        for signal in log.signals
    }
    signals = foxglove.Channel(
        "/signals",
        schema={"title": "offtrack.Signals", "type": "object", "properties": properties},
        context=context,
        metadata={f"unit.{plain[signal.name]}": signal.unit for signal in log.signals}
        | {f"name.{short}": name for name, short in plain.items()},
    )
    every = rows_of_poses(log)
    for k, (time, row) in enumerate(zip(log[TIME].tolist(), log.rows.tolist(), strict=True)):
        stamp = round(time * _NANOSECONDS)
        known = {name: value for name, value in zip(plain.values(), row, strict=True) if math.isfinite(value)}
        signals.log(known, log_time=stamp)
        if k % every == 0:
            moved = [
                _transform(m, stamp, WORLD, body.frame, body.positions[k].tolist(), body.turns[k].tolist())
                for body in bodies
            ]
            moved += [_transform(m, stamp, *one) for one in fixed]
            tf.log(m.FrameTransforms(transforms=moved), log_time=stamp)
        yield k + 1


def _write_calibration(foxglove: Any, context: Any, recording: RunRecording) -> None:
    """Calibrations of all cameras, once."""
    m = foxglove.messages
    for camera in recording.cameras:
        lens = {key.upper() if key in "dkrp" else key: value for key, value in camera.info.items()}
        numbers = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in lens.items()}
        calibration = m.CameraCalibration(timestamp=_stamp(m, 0), frame_id=camera.frame, **numbers)
        channel = foxglove.channels.CameraCalibrationChannel(f"{camera.topic}/calibration", context=context)
        channel.log(calibration, log_time=0)


def _write_images(foxglove: Any, context: Any, recording: RunRecording) -> Iterator[int]:
    """Recorded images as they are, in the order of their times; yields the number of images written."""
    m = foxglove.messages
    channel = foxglove.channels.CompressedImageChannel
    channels = {camera.frame: channel(camera.topic, context=context) for camera in recording.cameras}
    for count, (time, file, camera) in enumerate(recording.images(), start=1):
        stamp = round(time * _NANOSECONDS)
        image = m.CompressedImage(
            timestamp=_stamp(m, stamp),
            frame_id=camera.frame,
            data=file.read_bytes(),
            format=file.suffix.lstrip(".").lower(),
        )
        channels[camera.frame].log(image, log_time=stamp)
        yield count
