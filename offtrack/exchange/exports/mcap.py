"""A run as an MCAP file for Foxglove and Lichtblick: frames, bodies, paths, signals and recorded images.

Messages have Foxglove's own schemas, so that panels show them without set-up. Written by foxglove-sdk (extra
``export``).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from offtrack.exchange.exports.catalogue import ExportedRun
from offtrack.exchange.recordings.stereo_sequence import StereoSequence, find_sequence
from offtrack.reports.film import rgb
from offtrack.reports.player.playback import PALETTE, PlayedRun
from offtrack.reports.run_files import KINDS
from scenarios.extras import import_extra
from scenarios.options.scenario import load_any_scenario
from scenarios.results.atomic_files import check_new_file, replacing
from vehicle.foundation.polyline import rows_every
from vehicle.frames import FloatArray

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
