"""Dead-reckoned samples of the path, once a measured motion spans them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from estimators.off_tracking.pose_chain import Sample
from estimators.rigid_motion import chained, stretched
from vehicle.frames import inverse


def with_bridge(samples: tuple[Sample, ...], reckoned: tuple[Sample, ...], since: int) -> tuple[Sample, ...]:
    """Samples whose newest was measured from the tick ``since``, with the ``reckoned`` ones between the two.

    The closing error is distributed over the distance: a wrong slip turns the path, and a wrong yaw rate bends it, in
    proportion to the distance. The rest is a random walk between two known ends, a Brownian bridge: at the share u of
    the way the share u (1 - u) of its variance at the end remains. Without a reckoned sample at the newest tick there
    is no closing error, and nothing is put between.
    """
    index = {sample.tick: k for k, sample in enumerate(reckoned)}
    end = samples[0].tick
    if end not in index or since not in index:
        return samples
    between = reckoned[index[end] + 1 : index[since]]
    if not between:
        return samples
    X_OP = reckoned[index[since]].X_OS
    line = reckoned[index[end] : index[since] + 1]  # newest first
    steps = [float(np.linalg.norm(a.X_OS[:3, 3] - b.X_OS[:3, 3])) for a, b in pairwise(line)]
    travelled = np.cumsum(steps[::-1])[::-1]  # from the start to each of them
    if not travelled[0] > 0.0:
        return samples
    closing = inverse(X_OP) @ samples[0].X_OS @ inverse(line[0].X_OS) @ X_OP  # error as a motion in P
    measured = samples[0].covariance if samples[0].anchor == since else 0.0 * samples[0].covariance
    corrected = []
    for sample, distance in zip(between, travelled[1:], strict=True):
        u = float(distance / travelled[0])
        X_PS = stretched(closing, u) @ inverse(X_OP) @ sample.X_OS
        covariance = u**2 * measured + u * (1.0 - u) * line[0].covariance
        corrected.append(sample._replace(X_OS=chained(X_OP, X_PS), anchor=since, covariance=covariance))
    older = next(k for k, sample in enumerate(samples) if sample.tick <= since)
    return (samples[0], *corrected, *samples[older:])
