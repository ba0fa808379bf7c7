"""A run as an MCAP file for Foxglove and Lichtblick: frames, bodies, paths, signals and recorded images.

Messages have Foxglove's own schemas, so that panels show them without set-up. Written by foxglove-sdk (extra
``export``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np

from offtrack.exchange.exports.catalogue import ExportedRun
from offtrack.exchange.recordings.stereo_sequence import StereoSequence, find_sequence
from scenarios.assembly.adapters import outlines, vehicle_of
from scenarios.extras import check_extra
from scenarios.options.scenario import RoverScenario, Scenario, load_any_scenario
from scenarios.results.log import Log
from scenarios.results.run_directory import check_new_file, replacing
from vehicle.frames import FloatArray, rows_every
from vehicle.rover.description import load_rover

WORLD: Final = "W"
_HEIGHT: Final = 3.0  # of a drawn body, whose data sheet has none [m]
_CLEARANCE: Final = 1.0  # under it [m]
_FRAME_PERIOD: Final = 0.02  # of poses [s]
_BETWEEN_POINTS: Final = 0.1  # of drawn paths [m]
_BODY, _PATH, _FOLLOWED = (0.12, 0.37, 0.66, 0.35), (0.12, 0.37, 0.66, 1.0), (0.88, 0.45, 0.13, 1.0)
_NANOSECONDS: Final = 1_000_000_000


class _Body(NamedTuple):
    """A box in a frame of its own."""

    frame: str
    suffix: str  # of its signals x, y and psi
    middle: tuple[float, float, float]  # of the box in the frame [m]
    size: tuple[float, float, float]  # [m]


class _Line(NamedTuple):
    name: str
    points: FloatArray  # (n, 2) in W [m]
    colour: tuple[float, float, float, float]


class Mcap:
    """An MCAP file.

    Topics: ``/tf`` (frames of all units in W), ``/scene`` (bodies, path of the hitch or rover, path of the follow
    point), ``/signals`` (all signals of the log by name, one JSON object for each 10 ms; units and meanings in the
    schema), ``/camera/left`` and ``/camera/right`` (PNG images as recorded).
    """

    file: ClassVar = "signals.mcap"
    takes_images: ClassVar = True

    @staticmethod
    def write(run: ExportedRun, path: Path) -> tuple[Path, ...]:
        """Write the file.

        Raises:
            ValueError: one line, if the package is missing, the file exists, or the recording is no stereo recording.
        """
        check_extra("export", "MCAP needs", "foxglove")
        import foxglove.channels
        import foxglove.messages

        check_new_file(path)
        log, sequence = run.log, None if run.images is None else find_sequence(run.images, None)
        bodies, lines = _drawn(log, run.scenario)
        context = foxglove.Context()
        with replacing(path) as unfinished, foxglove.open_mcap(unfinished, context=context, allow_overwrite=True):
            _write_scene(foxglove, context, bodies, lines)
            total = len(log) + (0 if sequence is None else 2 * len(sequence.frames))
            for done in _write_log(foxglove, context, log, bodies):
                run.progress(done, total, "signals")
            if sequence is not None:
                for count in _write_images(foxglove, context, sequence):
                    run.progress(len(log) + count, total, "images")
        return (path,)


def _drawn(log: Log, scenario: Path) -> tuple[list[_Body], list[_Line]]:
    """Bodies and paths of a run."""
    loaded = load_any_scenario(str(scenario))
    return _DRAWN[loaded.vehicle_kind](log, loaded)


def _drawn_rover(log: Log, scenario: RoverScenario) -> tuple[list[_Body], list[_Line]]:
    rover = load_rover(scenario.vehicle)
    reach, radius = np.abs(rover.wheel_places[:, :2]).max(axis=0), rover.radius
    size = (2.0 * (float(reach[0]) + radius), 2.0 * float(reach[1]), radius)
    return [_Body("rover", "", (0.0, 0.0, 1.5 * radius), size)], [_Line("path of the rover", _places(log), _PATH)]


def _drawn_combination(log: Log, scenario: Scenario) -> tuple[list[_Body], list[_Line]]:
    units = outlines(vehicle_of(scenario))
    bodies = [
        _Body(
            unit.name,
            f"_{unit.name}",
            (0.5 * (unit.front_x + unit.rear_x), 0.0, _CLEARANCE + 0.5 * _HEIGHT),
            (unit.front_x - unit.rear_x, unit.width, _HEIGHT),
        )
        for unit in units
    ]
    lines = [_Line("path of the hitch", _places(log, bodies[-1].suffix), _PATH)]
    if len(units) > 1:
        rearmost = min(units[-1].axles)
        lines.append(_Line("path of the last axle", _places(log, bodies[-1].suffix, rearmost), _FOLLOWED))
    return bodies, lines


_DRAWN: Final[dict[str, Callable[[Log, Any], tuple[list[_Body], list[_Line]]]]] = {
    "trailer": _drawn_combination,
    "rover": _drawn_rover,
}


def _places(log: Log, suffix: str = "", ahead: float = 0.0) -> FloatArray:
    """Path (n, 2) of a point ``ahead`` [m] on a unit's axis, thinned."""
    psi = log[f"psi{suffix}"]
    x, y = log[f"x{suffix}"] + ahead * np.cos(psi), log[f"y{suffix}"] + ahead * np.sin(psi)
    places = np.column_stack([x, y])
    places = places[np.isfinite(places).all(axis=1)]
    return places if len(places) < 2 else places[rows_every(places, _BETWEEN_POINTS)]


def _write_scene(foxglove: Any, context: Any, bodies: list[_Body], lines: list[_Line]) -> None:
    m = foxglove.messages

    def at(x: float, y: float, z: float) -> Any:
        return m.Pose(position=m.Vector3(x=x, y=y, z=z), orientation=m.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))

    def coloured(colour: tuple[float, float, float, float]) -> Any:
        red, green, blue, alpha = colour
        return m.Color(r=red, g=green, b=blue, a=alpha)

    start = m.Timestamp(sec=0, nsec=0)
    boxes = [
        m.SceneEntity(
            timestamp=start,
            frame_id=body.frame,
            id=body.frame,
            frame_locked=True,
            cubes=[
                m.CubePrimitive(
                    pose=at(*body.middle),
                    size=m.Vector3(x=body.size[0], y=body.size[1], z=body.size[2]),
                    color=coloured(_BODY),
                )
            ],
        )
        for body in bodies
    ]
    strips = [
        m.SceneEntity(
            timestamp=start,
            frame_id=WORLD,
            id=line.name,
            lines=[
                m.LinePrimitive(
                    type=m.LinePrimitiveLineType.LineStrip,
                    pose=at(0.0, 0.0, 0.0),
                    thickness=0.06,
                    points=[m.Point3(x=x, y=y, z=0.02) for x, y in line.points.tolist()],
                    color=coloured(line.colour),
                )
            ],
        )
        for line in lines
    ]
    foxglove.channels.SceneUpdateChannel("/scene", context=context).log(
        m.SceneUpdate(entities=[*boxes, *strips]), log_time=0
    )


def _write_log(foxglove: Any, context: Any, log: Log, bodies: list[_Body]) -> Iterator[int]:
    """Signals and frames row by row; yields the number of rows written."""
    m = foxglove.messages
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
    poses = [np.column_stack([log[f"{name}{body.suffix}"] for name in ("x", "y", "psi")]) for body in bodies]
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
                    child_frame_id=body.frame,
                    translation=m.Vector3(x=x, y=y, z=0.0),
                    rotation=m.Quaternion(x=0.0, y=0.0, z=math.sin(0.5 * psi), w=math.cos(0.5 * psi)),
                )
                for body, (x, y, psi) in zip(bodies, (pose[k].tolist() for pose in poses), strict=True)
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
