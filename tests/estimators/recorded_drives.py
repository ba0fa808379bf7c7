"""Messages of rendered drives, kept as small files: camera motions, signals, and the true off-tracking.

``python -m tests.estimators.recorded_drives`` drives and records all of them anew, in some minutes.
"""

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
        data = {key: kept[key].astype(float) for key in kept.files}
    messages = [
        CombinationSignals(
            tick=int(row[0]),
            angles=row[1:3],
            speed=float(row[3]),
            steer=float(row[4]),
            articulation=row[5:6],
            yaw_rates=row[6:8],
            lateral_acceleration=float(row[8]),
        )
        for row in data["signals"]
    ]
    rows, last = [], -1
    for k, (tick, newest, *_) in enumerate(data["ticks"]):
        rows.append(Row(int(tick), _motion(data, k), tuple(one for one in messages if last < one.tick <= newest)))
        last = int(newest)
    return Drive(float(data["follow_distance"]), rows, {int(tick): value for tick, value in data["truth"]})


def _motion(data: dict[str, FloatArray], k: int) -> BodyMotion | None:
    _, _, tick, previous, health, anchor = data["ticks"][k].tolist()
    if tick < 0.0:
        return None
    (X_PC, X_AC), (covariance, of_anchor) = data["poses"][k], data["covariances"][k]
    common = np.hstack([0.1 * np.linalg.cholesky(of_anchor), np.zeros((6, 7))])  # as keyframe odometry states it
    return BodyMotion(
        tick=int(tick),
        previous_tick=int(previous),
        X_PC=X_PC,
        covariance=covariance,
        health=_HEALTH[int(health)],
        anchor=None if anchor < 0.0 else Anchor(tick=int(anchor), X_AC=X_AC, covariance=of_anchor, common=common),
    )


def record(name: str) -> None:
    """Drive and keep the messages of a name."""
    scenario, seed, settings = DRIVES[name]
    result = offtrack.run(scenario, seed=seed, settings={**settings, "off_tracking": f"{__name__}:Recorded"})
    truth = np.column_stack([np.round(1e3 * result.log["time"]), result.log["off_tracking_true"]])
    save(name, Drive(Recorded.follow_distance, Recorded.kept, dict(truth[np.isfinite(truth[:, 1])].tolist())))


def save(name: str, drive: Drive) -> None:
    """Keep a drive."""
    ticks, poses, covariances = [], [], []
    for tick, motion, signals in drive.rows:
        newest, anchor = signals[-1].tick if signals else -1, motion.anchor if motion else None
        own = (motion.tick, motion.previous_tick, _HEALTH.index(motion.health)) if motion else (-1, -1, -1)
        ticks.append((tick, newest, *own, anchor.tick if anchor else -1))
        poses.append([motion.X_PC if motion else np.eye(4), anchor.X_AC if anchor else np.eye(4)])
        covariances.append([motion.covariance if motion else np.eye(6), anchor.covariance if anchor else np.eye(6)])
    arrays: dict[str, Any] = {
        "follow_distance": drive.follow_distance,
        "ticks": ticks,
        "poses": poses,
        "covariances": covariances,
        "signals": [
            (m.tick, *m.angles, m.speed, m.steer, *m.articulation, *m.yaw_rates, m.lateral_acceleration)
            for row in drive.rows
            for m in row.signals
        ],
        "truth": [(tick, value) for tick, value in drive.truth.items() if tick % 100 == 0],
    }
    arrays = {key: np.array(value, dtype=np.float32) for key, value in arrays.items()}
    np.savez_compressed(FOLDER / f"{name}.npz", **arrays)


if __name__ == "__main__":
    from tests.estimators import recorded_drives

    for wanted in sys.argv[1:] or DRIVES:
        recorded_drives.record(wanted)
