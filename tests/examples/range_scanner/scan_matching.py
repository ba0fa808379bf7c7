"""Off-tracking from a planar range scanner by matching successive scans: an example of an estimator of one's own.

``--set sensor=range_scanner:RangeScanner --set off_tracking=scan_matching:ScanMatching`` names both when this folder is
the working directory or on ``PYTHONPATH``.

Each scan is aligned with the one before by iterated least squares of the distances from its points to lines through
neighbouring points of the older scan (point-to-line ICP). The motion is planar: roll and pitch of the trailer only
enter through an assumed uncertainty. ``OffTrackingBuffer`` chains the motions and compares the path of the hitch with
the follow point.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar, Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from range_scanner import NOISE, RangeScan, RangeScanner
from scipy.spatial import KDTree

from estimators.estimates import Health, OffTracking
from estimators.off_tracking.buffer import BodyMotion, BufferMemory, OffTrackingBuffer
from estimators.rigid_motion import UncertainMotion, change_frame, lasting, nothing_common
from vehicle.frames import FloatArray, Pose2, rotation_zyx, transform

if TYPE_CHECKING:
    from estimators.context import TrailerContext

_GATES: Final = (1.0, 0.7, 0.5, *(0.3,) * 12)  # greatest distance of a point from its partner, per iteration [m]
_CONVERGED: Final = 1e-4  # step of the last iterations [m, rad]
_FEWEST: Final = 25  # matched points; with fewer the scan is lost
_WORST: Final = 0.2  # standard deviation of a displacement, beyond which the scan is lost [m]
_WINDOW: Final = 3  # neighbours to either side that a line is fitted through
_BREAK: Final = 0.5  # distance between neighbouring points, from which on they lie on different things [m]
_THICK: Final = 0.1  # RMS distance of these neighbours from their line, beyond which there is no line [m]
_HUBER: Final = 2.0  # residuals beyond so many standard deviations weigh less
# Neighbouring points share the errors of the line that they are matched with, and on foliage those of its shape: each
# window counts as about one independent point.
_CORRELATION: Final = 2 * _WINDOW + 1
_TILT: Final = math.radians(0.1)  # roll and pitch from one scan to the next, assumed [rad]
_HEAVE: Final = 0.005  # vertical motion from one scan to the next, assumed [m]


class Lines(NamedTuple):
    """Points of a scan on locally straight outlines."""

    points: FloatArray  # (n, 2) in the scanner's frame [m]
    normals: FloatArray  # (n, 2)


class Match(NamedTuple):
    """Planar motion of the scanner between two scans."""

    pose: Pose2  # of the newer scan in the older one
    covariance: FloatArray  # (3, 3) of x [m], y [m], psi [rad]
    matched: int  # points


class ScanMatchingMemory(NamedTuple):
    """The scan before, the last motion as a first guess, and the buffer."""

    scan: RangeScan | None
    velocity: FloatArray  # (3,) motion per tick: x [m], y [m], psi [rad]
    buffer: BufferMemory


class ScanMatching:
    """Off-tracking of a trailer from the scans of a ``RangeScanner`` on it."""

    sensor: ClassVar[str] = "range_scanner:RangeScanner"

    def __init__(self, x: float, follow_distance: float) -> None:
        """For a scanner ``x`` [m] from the hitch and a follow point ``follow_distance`` [m] behind it."""
        self._X_SL = transform(np.eye(3), np.array([x, 0.0, 0.0]))
        self._buffer = OffTrackingBuffer(follow_distance)

    @classmethod
    def of(cls, context: TrailerContext) -> Self:
        """Estimator for the context's trailer.

        Raises:
            ValueError: if the run's sensor is another one.
        """
        if not isinstance(context.sensor, RangeScanner):
            raise ValueError("off_tracking = scan_matching:ScanMatching needs sensor = range_scanner:RangeScanner")
        return cls(context.sensor.x, context.follow_distance)

    def init(self) -> ScanMatchingMemory:
        """Memory before the first scan."""
        return ScanMatchingMemory(None, np.zeros(3), self._buffer.init())

    def step(self, memory: ScanMatchingMemory, scan: RangeScan) -> tuple[ScanMatchingMemory, OffTracking | None]:
        """Memory with the scan in it, and the off-tracking at its tick; None for the first scan."""
        if memory.scan is None or scan.tick <= memory.scan.tick:
            return memory._replace(scan=memory.scan or scan), None
        ticks = scan.tick - memory.scan.tick
        match = aligned(memory.scan, scan, Pose2(*(memory.velocity * ticks).tolist()))
        buffer, off_tracking = self._buffer.step(memory.buffer, self._motion(memory.scan.tick, scan.tick, match))
        velocity = memory.velocity if match is None else np.array(match.pose) / ticks
        return ScanMatchingMemory(scan, velocity, buffer), off_tracking

    def _motion(self, previous_tick: int, tick: int, match: Match | None) -> BodyMotion:
        """Motion of the trailer's frame S from that of the scanner."""
        if match is None:
            X, covariance, health = np.eye(4), np.full((6, 6), np.inf), Health.LOST
        else:
            x, y, psi = match.pose
            covariance_P = np.diag([_TILT, _TILT, 0.0, 0.0, 0.0, _HEAVE]) ** 2
            covariance_P[np.ix_([3, 4, 2], [3, 4, 2])] = match.covariance
            moved = UncertainMotion(transform(rotation_zyx(psi, 0.0, 0.0), np.array([x, y, 0.0])), covariance_P)
            X, covariance, _ = change_frame(self._X_SL, moved)
            health = Health.OK
        common = nothing_common() if match is None else lasting(covariance, 0.2)
        return BodyMotion(
            tick=tick, previous_tick=previous_tick, X_PC=X, covariance=covariance, health=health, common=common
        )


def aligned(older: RangeScan, newer: RangeScan, guess: Pose2) -> Match | None:
    """Motion of the scanner from the older to the newer scan; None if they cannot be aligned."""
    lines, points = lines_of(older), _points(newer)
    points = points[np.isfinite(points).all(axis=1)]
    if len(lines.points) < _FEWEST or len(points) < _FEWEST:
        return None
    tree, pose, step = KDTree(lines.points), np.array(guess), np.zeros(3)
    for gate in _GATES:
        placed, arms = _placed(points, pose)
        nearest = tree.query(placed, distance_upper_bound=gate)
        distance, partner = np.asarray(nearest[0]), np.asarray(nearest[1])
        near = np.isfinite(distance)
        if near.sum() < _FEWEST:
            return None
        normals = lines.normals[partner[near]]
        residuals = ((placed[near] - lines.points[partner[near]]) * normals).sum(axis=1)
        J = np.column_stack([normals, (normals * arms[near]).sum(axis=1)])
        scale = max(NOISE, 1.48 * float(np.median(np.abs(residuals))))  # of normal errors
        weights = np.minimum(1.0, _HUBER * scale / np.maximum(np.abs(residuals), 1e-9))
        information = (J * weights[:, None]).T @ J
        if np.linalg.cond(information) > 1e8:
            return None
        step = -np.linalg.solve(information, J.T @ (weights * residuals))
        pose = pose + step
        if gate == _GATES[-1] and np.abs(step).max() < _CONVERGED:
            break
    variance = max(NOISE**2, float(np.average(residuals**2, weights=weights)))
    covariance = _CORRELATION * variance * np.linalg.inv(information)
    if np.abs(step).max() > 10.0 * _CONVERGED or math.sqrt(covariance[:2, :2].trace()) > _WORST:
        return None
    return Match(Pose2(*pose.tolist()), covariance, int(near.sum()))


def lines_of(scan: RangeScan) -> Lines:
    """Points of a scan that lie on a line with their neighbours."""
    points = _points(scan)
    count = 2 * _WINDOW + 1
    gaps = np.hypot(*np.diff(points, axis=0).T)  # nan where a beam meets nothing
    joined = np.lib.stride_tricks.sliding_window_view(gaps < _BREAK, count - 1).all(axis=1)
    windows = np.lib.stride_tricks.sliding_window_view(points, count, axis=0)[joined]  # (m, 2, count)
    around = windows - windows.mean(axis=2, keepdims=True)
    spread, axes = np.linalg.eigh(around @ around.transpose(0, 2, 1) / count)
    straight: NDArray[np.bool_] = np.sqrt(np.maximum(spread[:, 0], 0.0)) < _THICK
    return Lines(windows[straight][:, :, _WINDOW], axes[straight][:, :, 0])


def _points(scan: RangeScan) -> FloatArray:
    """End points (n, 2) of the beams in the scanner's frame [m]; nan where a beam meets nothing."""
    ranges = np.where(np.isfinite(scan.ranges), scan.ranges, np.nan)
    return np.column_stack([ranges * np.cos(scan.bearings), ranges * np.sin(scan.bearings)])


def _placed(points: FloatArray, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (n, 2) moved by a pose (3,), and their derivative by its angle."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    turned = points @ np.array([[c, s], [-s, c]])
    return turned + pose[:2], np.column_stack([-turned[:, 1], turned[:, 0]])
