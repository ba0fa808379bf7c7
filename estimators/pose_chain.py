"""Poses of the trailer body along its way, newest first, with the uncertainty of every increment between them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from estimators.hitch_path import Crossing
from estimators.rigid_motion import UncertainMotion, chained, composed
from vehicle.frames import FloatArray, inverse

# Share of the variance that all increments have in common. With it the normalised error of the off-tracking on rendered
# frames has an RMS of 0.5 to 1.0 with scenery and 1.0 to 1.7 on bare ground; without it 1.1 to 1.9 and 1.8 to 2.1.
_COMMON = 0.04
_STEP = 0.02  # samples nearer than this to the next older one are dropped when the next arrives [m]


class Sample(NamedTuple):
    """The body at one tick, and the increment that starts there and ends at the next newer sample."""

    tick: int
    X_OS: FloatArray  # (4, 4)
    to_next: FloatArray  # (6, 6) covariance of the increment to the next newer sample; zero for the newest
    doubtful: bool  # whether that increment is degraded or bridged


def first_sample(tick: int) -> Sample:
    """The sample that a new path begins with; it defines the frame O."""
    return Sample(tick, np.eye(4), np.zeros((6, 6)), False)


def up_to(samples: tuple[Sample, ...], tick: int) -> tuple[Sample, ...]:
    """The samples without any newer than ``tick``; a new path if none is of that tick."""
    kept = tuple(sample for sample in samples if sample.tick <= tick)
    return kept if kept and kept[0].tick == tick else (first_sample(tick),)


def extended(
    samples: tuple[Sample, ...], tick: int, increment: UncertainMotion, doubtful: bool, keep_start: bool
) -> tuple[Sample, ...]:
    """The samples with one more at the end of the increment.

    The newest sample so far is dropped if it lies too near to its predecessor, unless it is to be kept: a standstill
    does not fill the chain, and the newest sample is always where the body really is.
    """
    while len(samples) > 1 and not keep_start and _distance(samples[0], samples[1]) < _STEP:
        newest, older, *_ = samples
        to_newest = UncertainMotion(inverse(older.X_OS) @ newest.X_OS, older.to_next)
        increment, doubtful = composed(to_newest, increment), doubtful or older.doubtful
        samples = samples[1:]
    end = first_sample(tick)._replace(X_OS=chained(samples[0].X_OS, increment.X))
    return (end, samples[0]._replace(to_next=increment.covariance, doubtful=doubtful), *samples[1:])


def _distance(a: Sample, b: Sample) -> float:
    return float(np.linalg.norm(a.X_OS[:3, 3] - b.X_OS[:3, 3]))


def positions_now(samples: tuple[Sample, ...]) -> FloatArray:
    """Hitch positions (n, 3) in the newest S, newest first; de Saxe 2018, eqs 3 to 5."""
    X_OS = samples[0].X_OS
    p_OS = np.array([sample.X_OS[:3, 3] for sample in samples])
    positions: FloatArray = (p_OS - X_OS[:3, 3]) @ X_OS[:3, :3]
    return positions


def lateral_std(samples: tuple[Sample, ...], positions: FloatArray, passed: Crossing, path_tangent: float) -> float:
    """Standard deviation [m] of the path's y at the crossing, from the errors of all increments since.

    With an error (d_theta, d_p) in the increment that ends at p_i, the older path moves by -(d_theta x r + d_p),
    r being its position from p_i: along the normal n of the path, -(d_theta . (r x n) + d_p . n). The increment in
    which the crossing falls counts in full. Errors are independent but for a share of their variance that is common
    to all increments, constant along the axes of the body: the odometry's slowly changing bias.
    """
    since = samples[1 : passed.beyond + 1]
    R_CP = samples[0].X_OS[:3, :3].T @ np.array([sample.X_OS[:3, :3] for sample in since])  # starts in newest S
    n = np.array([-math.tan(path_tangent), 1.0, 0.0])  # y at a fixed x, so along the normal over its y part
    point = np.array([positions[passed.beyond, 0], passed.y, positions[passed.beyond, 2]])
    r = point - positions[: passed.beyond]
    gradient = np.concatenate([np.cross(r, n), np.broadcast_to(n, r.shape)], axis=1).reshape(-1, 2, 3) @ R_CP
    g = gradient.reshape(-1, 6)
    covariances = np.array([sample.to_next for sample in since])
    independent = np.einsum("ij,ijk,ik->", g, covariances, g)
    together = np.einsum("ij,ij->j", g, np.sqrt(np.einsum("ijj->ij", covariances)))
    return math.sqrt(independent + _COMMON * together @ together)
