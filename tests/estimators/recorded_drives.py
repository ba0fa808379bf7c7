"""Messages of rendered drives, kept as small files: camera motions, signals, and the true off-tracking.

Without a motion a row of a file is NaN from its third column on. ``python -m tests.estimators.recorded_drives`` drives
and records all of them anew, in some minutes.
"""

import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

import offtrack
from estimators.context import TrailerContext
from estimators.estimates import Anchor, CameraOffTracking, Health, OffTracking
from estimators.off_tracking.buffer import BodyMotion, BufferMemory, OffTrackingBuffer
from estimators.off_tracking.signal_fusion import FusionMemory, SignalFusion
from estimators.off_tracking.viso_ot import VisoOt, VisoOtMemory, body_motion
from sensors.messages import CombinationSignals, TrailerView
from vehicle.combination.description import load_vehicle
from vehicle.frames import FloatArray

FOLDER = Path(__file__).parent / "recorded"
VEHICLE = load_vehicle("uk_longer_semitrailer")
_HEALTH = list(Health)
_UPPER = np.triu_indices(6)
_ICE = {"surface.grade": 0.0, "speed_kmh": 14.0, "course.turn_deg": 60.0, "course.exit": 15.0}
_BANK = {"surface.grade": 0.0, "surface.cross_fall": 0.05}
_FAULT = {"course.turn_deg": 90.0, "surface.friction": 0.2}
DRIVES: dict[str, tuple[str, int, dict[str, Any]]] = {
    "level_ice": ("roundabout-low-friction", 411, {**_ICE, "surface.friction": 0.15, "surface.cross_fall": 0.0}),
    "banked_ice": ("roundabout-low-friction", 412, {**_ICE, **_BANK, "surface.friction": 0.3, "speed_kmh": 17.0}),
    "pulling_away": (str(FOLDER / "pulling_away.toml"), 441, {}),
    "turned_camera": ("roundabout", 2, {**_FAULT, "faults": "decalibration:0,2,0@8"}),
    "rolled_camera": ("roundabout", 2, {**_FAULT, "faults": "decalibration:2,0,0@8"}),
    "late_right_camera": ("roundabout", 2, {**_FAULT, "faults": "desync:0.05@8"}),
    "blackout": ("roundabout", 2, {**_FAULT, "faults": "blackout@12.5+2"}),
}


class Row(NamedTuple):
    """What arrived with a frame."""

    tick: int
    motion: BodyMotion | None
    signals: tuple[CombinationSignals, ...]


class Drive(NamedTuple):
    """A recorded drive."""

    follow_distance: float  # [m]
    rows: list[Row]
    truth: dict[int, float]  # off-tracking by tick [m]

    def estimates(self) -> dict[int, OffTracking]:
        """Estimates of the fusion from the messages, by tick."""
        return {row.tick: estimate for row, _, estimate in self._fused() if estimate is not None}

    def in_outages(self, first: int, every: int, duration: int) -> Iterator[dict[int, OffTracking]]:
        """Estimates without images for a ``duration``, for outages begun from ``first`` on [ticks]."""
        buffer = OffTrackingBuffer(self.follow_distance)
        fusion = SignalFusion(VEHICLE, 1, self.follow_distance, buffer)
        states = {row.tick: state for row, state, _ in self._fused()}
        for begin in range(first, self.rows[-1].tick - duration, every):
            (memory, path), results = states[begin], {}
            for tick, _, signals in self.rows:
                if begin < tick <= begin + duration:
                    memory, path, estimate = fusion.step(memory, path, tick, None, signals)
                    if estimate is not None:
                        results[tick] = estimate
            yield results

    def _fused(self) -> Iterator[tuple[Row, tuple[FusionMemory, BufferMemory], OffTracking | None]]:
        buffer = OffTrackingBuffer(self.follow_distance)
        fusion = SignalFusion(VEHICLE, 1, self.follow_distance, buffer)
        memory, path = fusion.init(), buffer.init()
        for row in self.rows:
            memory, path, estimate = fusion.step(memory, path, *row)
            yield row, (memory, path), estimate

    def of_camera(self) -> dict[int, OffTracking]:
        """Estimates of the camera alone, by tick."""
        buffer = OffTrackingBuffer(self.follow_distance)
        memory, results = buffer.init(), {}
        for tick, motion, _ in self.rows:
            if motion is not None:
                memory, results[tick] = buffer.step(memory, motion)
        return results


class Recorded(VisoOt[Any]):
    """VISO-OT that keeps its messages, of the run that was opened last."""

    kept: ClassVar[list[Row]] = []
    follow_distance: ClassVar[float] = 0.0  # [m]

    @classmethod
    def of(cls, context: TrailerContext) -> Self:
        cls.kept.clear()
        Recorded.follow_distance = context.follow_distance
        return super().of(context)

    def step(self, memory: VisoOtMemory[Any], message: Any) -> tuple[VisoOtMemory[Any], CameraOffTracking | None]:
        memory, estimate = super().step(memory, message)
        motion = None if estimate is None else estimate.motion
        signals = message.signals if isinstance(message, TrailerView) else ()
        self.kept.append(Row(message.tick, None if motion is None else body_motion(self._X_SC, motion), signals))
        return memory, estimate


def load(name: str) -> Drive:
    """The drive of a name."""
    with np.load(FOLDER / f"{name}.npz") as kept:
        motions, signals, truth = (kept[key].astype(float) for key in ("motions", "signals", "truth"))
        messages = [_signals(row) for row in signals]
        last, rows = -1, []
        for row in motions:
            tick = int(row[0])
            arrived = tuple(message for message in messages if last < message.tick <= int(row[1]))
            last = arrived[-1].tick if arrived else last
            rows.append(Row(tick, None if math.isnan(row[3]) else _motion(row[2:]), arrived))
        return Drive(float(kept["follow_distance"]), rows, {int(t): v for t, v in truth})


def _motion(row: FloatArray) -> BodyMotion:
    tick, previous, health = (int(value) for value in row[:3])
    anchor = None
    if not math.isnan(row[3]):
        anchor = Anchor(tick=int(row[3]), X_AC=_pose(row[37:49]), covariance=_symmetric(row[49:]))
    return BodyMotion(
        tick=tick,
        previous_tick=previous,
        X_PC=_pose(row[4:16]),
        covariance=_symmetric(row[16:37]),
        health=_HEALTH[health],
        anchor=anchor,
    )


def _row(row: Row) -> list[float]:
    newest = float(row.signals[-1].tick) if row.signals else -1.0
    motion = row.motion
    if motion is None:
        return [float(row.tick), newest, *[math.nan] * 70]
    anchor = motion.anchor
    measured = [math.nan] * 33 if anchor is None else [*anchor.X_AC[:3].ravel(), *anchor.covariance[_UPPER]]
    return [
        *(
            float(row.tick),
            newest,
            float(motion.tick),
            float(motion.previous_tick),
            float(_HEALTH.index(motion.health)),
        ),
        math.nan if anchor is None else float(anchor.tick),
        *motion.X_PC[:3].ravel(),
        *motion.covariance[_UPPER],
        *measured,
    ]


def _pose(values: FloatArray) -> FloatArray:
    return np.vstack([values.reshape(3, 4), [0.0, 0.0, 0.0, 1.0]])


def _symmetric(upper: FloatArray) -> FloatArray:
    matrix = np.zeros((6, 6))
    matrix[_UPPER] = upper
    return matrix + np.triu(matrix, 1).T


def _signals(row: FloatArray) -> CombinationSignals:
    return CombinationSignals(
        tick=int(row[0]),
        angles=row[1:3],
        speed=float(row[3]),
        steer=float(row[4]),
        articulation=row[5:6],
        yaw_rates=row[6:8],
        lateral_acceleration=float(row[8]),
    )


def record(name: str) -> None:
    """Drive and keep the messages of a name."""
    scenario, seed, settings = DRIVES[name]
    result = offtrack.run(scenario, seed=seed, settings={**settings, "off_tracking": f"{__name__}:Recorded"})
    truth = np.column_stack([1e3 * result.log["time"], result.log["off_tracking_true"]])
    truth = truth[np.isfinite(truth[:, 1]) & (np.round(truth[:, 0]) % 100 == 0)]
    messages = [message for row in Recorded.kept for message in row.signals]
    np.savez_compressed(
        FOLDER / f"{name}.npz",
        follow_distance=Recorded.follow_distance,
        motions=np.array([_row(row) for row in Recorded.kept], dtype=np.float32),
        signals=np.array([_of(message) for message in messages], dtype=np.float32),
        truth=np.round(truth, 4).astype(np.float32),
    )


def _of(message: CombinationSignals) -> list[float]:
    return [
        float(message.tick),
        *message.angles.tolist(),
        message.speed,
        message.steer,
        *message.articulation.tolist(),
        *message.yaw_rates.tolist(),
        message.lateral_acceleration,
    ]


if __name__ == "__main__":
    from tests.estimators import recorded_drives

    for wanted in sys.argv[1:] or DRIVES:
        recorded_drives.record(wanted)
