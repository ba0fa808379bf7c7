"""Chain of past poses of the trailer body, newest first, with dead-reckoned samples that bridge gaps.

Every sample but the first was measured from an older one, its anchor: the sample before it for odometry from frame to
frame, or a keyframe. The error between two samples comes from the links between them alone: a whole chain of frames in
the first case, a few keyframes in the second.

The hitch's path consists of the samples of forward travel. In reverse, samples leave the path as soon as the hitch is
behind the lateral line through them, and the newest sample is connected to the next one behind. A keyframe that motions
are still measured from stays among the samples, off the path.
"""

import math
from collections.abc import Sequence
from itertools import islice, pairwise
from typing import NamedTuple

import numpy as np

from estimators.estimates import Anchor
from estimators.off_tracking.hitch_path import Crossing
from estimators.rigid_motion import UncertainMotion, along_axes, chained, composed, continued, nothing_common, stretched
from vehicle.frames import FloatArray, arc_length, cross, inverse, transform

_STEP = 0.02  # least distance between samples [m]
_TILT = 0.025  # tilt of the mean plane of a path to the side, 1 sigma: the usual cross-fall of a road [rad]


class Sample(NamedTuple):
    """Pose of the body at one tick, and the measurement that placed it there."""

    tick: int
    X_OS: FloatArray  # (4, 4)
    anchor: int  # tick of the sample it was measured from; its own tick for the first
    covariance: FloatArray  # (6, 6) of that measurement's error (d_theta [rad], d_p [m]), along the axes of O
    doubtful: bool  # True: that measurement is degraded or bridged
    on_path: bool = True  # False: a keyframe ahead of the hitch after reversing
    joined: bool = False  # True: samples behind it were removed after reversing
    common: FloatArray = nothing_common()  # (6, 13) part of that error that measurements share, likewise


def first_sample(tick: int) -> Sample:
    """First sample of a new path; it defines the frame O."""
    return Sample(tick, np.eye(4), tick, np.zeros((6, 6)), False)


def up_to(samples: tuple[Sample, ...], tick: int) -> tuple[Sample, ...]:
    """Samples up to ``tick``; a new path if there is none of that tick."""
    place = next((k for k, sample in enumerate(samples) if sample.tick <= tick), None)
    return (first_sample(tick),) if place is None or samples[place].tick < tick else samples[place:]


def extended(
    samples: tuple[Sample, ...],
    tick: int,
    increment: UncertainMotion,
    doubtful: bool,
    keep_start: bool,
    anchor: Anchor | None = None,
    kept: int | None = None,
) -> tuple[Sample, ...]:
    """Samples with one more at the end of the increment, measured from the anchor if that is still among them.

    The previous newest sample is dropped if it is too near to its predecessor and ``keep_start`` is not set: slow
    travel does not fill the chain, and the newest sample is always the current pose. Samples ahead of a hitch in
    reverse are dropped as well. The anchor, or the sample of the tick ``kept``, stays.
    """
    measured, origin = increment, samples[0]
    if anchor is not None and (found := [sample for sample in samples if sample.tick == anchor.tick]):
        measured, origin = anchor.uncertain, found[0]
    X_OS, (_, covariance, common) = chained(samples[0].X_OS, increment.X), continued(origin.X_OS, measured)
    end = Sample(tick, X_OS, origin.tick, covariance, doubtful, common=common)
    if keep_start:
        return (end, *samples)
    keyframe = kept if anchor is None else anchor.tick
    return _thinned(_without_reversed((end, *samples), keyframe), keyframe)


def measured_from(samples: tuple[Sample, ...], tick: int, covariance: FloatArray) -> tuple[Sample, ...]:
    """Samples whose newest was measured from that of another tick, with this covariance (6, 6) along its axes."""
    origin = next(sample for sample in samples if sample.tick == tick)
    covariance = along_axes(origin.X_OS[:3, :3], covariance)
    return (samples[0]._replace(anchor=tick, covariance=covariance, common=nothing_common()), *samples[1:])


def rested(
    samples: tuple[Sample, ...], tick: int, covariance: FloatArray, doubtful: bool, keyframe: int | None
) -> tuple[Sample, ...]:
    """Samples of a body at rest until a later tick, with a motion error of this covariance (6, 6)."""
    newest = samples[0]
    end = Sample(tick, newest.X_OS, newest.tick, along_axes(newest.X_OS[:3, :3], covariance), doubtful)
    return _thinned((end, *samples), keyframe)


def _without_reversed(samples: tuple[Sample, ...], keyframe: int | None) -> tuple[Sample, ...]:
    """Samples without those of the path that are ahead of the newest after reversing.

    The ``keyframe`` (a tick) that later motions are measured from only leaves the path. If only the last but one is
    ahead, that may be noise, and the path does not count as cut.
    """
    hitch, place, passed, cut = samples[0].X_OS[:3, 3], 1, 0, False
    while place < len(samples):
        other = samples[place]
        if other.on_path and float((hitch - other.X_OS[:3, 3]) @ other.X_OS[:3, 0]) >= 0.0:
            break  # the hitch is ahead of the lateral line through it
        cut |= other.on_path and (passed > 0 or other.joined)
        passed += other.on_path
        if other.tick == keyframe:
            samples = (*samples[:place], other._replace(on_path=False), *samples[place + 1 :])
            place += 1
        else:
            samples = _without(samples, place)
    return (samples[0]._replace(joined=True), *samples[1:]) if cut else samples


def _thinned(samples: tuple[Sample, ...], keyframe: int | None) -> tuple[Sample, ...]:
    """Samples without the last but one of the path, if it is too near to the one before it.

    If the last but one is the ``keyframe`` (a tick) that later motions are measured from, the one before it is dropped.
    """
    while len(near := list(islice((k for k, sample in enumerate(samples) if sample.on_path), 3))) > 2:
        if not np.linalg.norm(samples[near[1]].X_OS[:3, 3] - samples[near[2]].X_OS[:3, 3]) < _STEP:
            break
        samples = _without(samples, near[2] if samples[near[1]].tick == keyframe else near[1])
    return samples


def levelled(samples: Sequence[Sample]) -> tuple[FloatArray, FloatArray]:
    """R_OS (3, 3) of the newest sample without its own roll and pitch, and positions (n, 3) of the hitch along it.

    Positions are those from the newest, newest first; de Saxe 2018, eqs 3 to 5.

    Off-tracking is measured in plan, so z should be vertical. Motions do not show where that is; z is the mean of the
    body's z axes over the path, in which its roll and pitch cancel, and those of the road in part. `level_std` is the
    error that this leaves. The x axis keeps its heading.
    """
    poses = np.array([sample.X_OS for sample in samples])
    z = poses[:, :3, 2].sum(axis=0)
    y = cross(z, poses[0, :3, 0])
    y, z = y / np.linalg.norm(y), z / np.linalg.norm(z)
    R_OS = np.column_stack([cross(y, z), y, z])
    return R_OS, (poses[:, :3, 3] - poses[0, :3, 3]) @ R_OS


def links_between(samples: tuple[Sample, ...], older: int) -> tuple[list[int], list[int]]:
    """Measurements between the newest sample and the one with the index ``older``, by the samples that they placed.

    Errors of the first ones move the path behind them, those of the others move the older sample itself.
    """
    index = {sample.tick: k for k, sample in enumerate(samples)}
    newest, past = _anchor_chain(samples, index, 0), _anchor_chain(samples, index, older)
    shared = set(newest) & set(past)
    return [k for k in newest if k not in shared], [k for k in past if k not in shared]


def _anchor_chain(samples: tuple[Sample, ...], index: dict[int, int], start: int) -> list[int]:
    """Indices of the sample, its anchor, the anchor's anchor and so on."""
    line, place = [start], index.get(samples[start].anchor, start)
    while place != line[-1]:
        line.append(place)
        place = index.get(samples[place].anchor, place)
    return line


def _without(samples: tuple[Sample, ...], victim: int) -> tuple[Sample, ...]:
    """Samples without one; those measured from it are moved to its anchor."""
    gone = samples[victim]
    newer = tuple(_reanchored(sample, gone) if sample.anchor == gone.tick else sample for sample in samples[:victim])
    return (*newer, *samples[victim + 1 :])


def _reanchored(sample: Sample, gone: Sample) -> Sample:
    """Sample with its measurement composed with that of the removed one."""
    if gone.anchor == gone.tick:  # the first sample has none
        return sample._replace(anchor=sample.tick, covariance=np.zeros((6, 6)), common=nothing_common(), doubtful=False)
    shift = transform(np.eye(3), sample.X_OS[:3, 3] - gone.X_OS[:3, 3])  # along the axes of O, as the errors are
    first = UncertainMotion(np.eye(4), gone.covariance, gone.common)
    _, covariance, common = composed(first, UncertainMotion(shift, sample.covariance, sample.common))
    doubtful = sample.doubtful or gone.doubtful
    return sample._replace(anchor=gone.anchor, covariance=covariance, common=common, doubtful=doubtful)


def closed(samples: tuple[Sample, ...], index: int, X_CK: FloatArray) -> tuple[Sample, ...]:
    """Samples corrected so that the one at ``index`` has its measured pose X_CK (4, 4) in the newest one.

    Older samples move with it rigidly; those between are corrected by their share of the distance.
    """
    X_OC = samples[0].X_OS
    distance = arc_length(levelled(samples)[1][:, :2])
    share = np.minimum(distance / distance[index], 1.0)
    correction = X_CK @ inverse(inverse(X_OC) @ samples[index].X_OS)
    return tuple(
        sample._replace(X_OS=chained(X_OC, stretched(correction, float(part)) @ inverse(X_OC) @ sample.X_OS))
        for sample, part in zip(samples, share, strict=True)
    )


def lateral_std(
    samples: Sequence[Sample],
    links: tuple[list[int], list[int]],
    positions: FloatArray,
    R_OS: FloatArray,
    passed: Crossing,
    path_tangent: float,
) -> float:
    """Standard deviation [m] of the path's y at the crossing, from the errors of the measurements that lead there.

    An error (d_theta, d_p) in the measurement that ends at p_i moves the older path by -(d_theta x r + d_p), with r its
    position from p_i; along the normal n of the path this is -(d_theta . (r x n) + d_p . n). The measurement that
    contains the crossing counts in full. What measurements share adds up with its sign along the path. The two samples
    beside the crossing were mostly measured from one keyframe, and share its points, half of the variance of each: the
    larger one counts. ``positions`` (n, 3) are those along the axes R_OS.
    """
    newer, older = links
    ends, sense = [*newer, *older], np.repeat([[1.0], [-1.0]], [len(newer), len(older)], axis=0)
    R_CO = R_OS.T
    n = np.array([-math.tan(path_tangent), 1.0, 0.0])  # y at a fixed x, so along the normal over its y part
    point = np.array([positions[passed.beyond, 0], passed.y, positions[passed.beyond, 2]])
    r = point - positions[ends]
    gradient = np.concatenate([np.cross(r, n), np.broadcast_to(n, r.shape)], axis=1).reshape(-1, 2, 3) @ R_CO
    gradient = gradient.reshape(-1, 1, 6)
    by_common = (gradient @ np.array([samples[end].common for end in ends]))[:, 0]
    whole = gradient @ np.array([samples[end].covariance for end in ends]) @ gradient.swapaxes(1, 2)
    independent = whole[:, 0, 0] - np.sum(np.square(by_common), axis=1)
    if newer and older and samples[newer[-1]].anchor == samples[older[-1]].anchor:
        independent[-1] = max(0.0, independent[-1] - independent[len(newer) - 1])
    together = np.sum(sense * by_common, axis=0)
    return math.sqrt(max(0.0, float(independent.sum() + together @ together)))


def level_std(X_OS: FloatArray, R_OS: FloatArray, point: FloatArray) -> float:
    """Standard deviation [m] of the y of a ``point`` (3,) of the path along the levelled axes R_OS.

    X_OS is the newest pose. If z is tilted to one side by an angle, a point of the path that is higher than the body's
    x axis there lies to the side by the angle times that height: on a crest, or where a trailer cuts a conical bend.
    """
    x_axis = R_OS.T @ X_OS[:3, 0]
    height = float(point[2] - point[0] * x_axis[2] / x_axis[0])
    return _TILT * abs(height)


def with_bridge(samples: tuple[Sample, ...], reckoned: tuple[Sample, ...], since: int) -> tuple[Sample, ...]:
    """Samples whose newest was measured from the tick ``since``, with the ``reckoned`` ones between the two.

    The closing error is distributed over the distance: a wrong slip turns the path, and a wrong yaw rate bends it, in
    proportion to the distance. The rest is a random walk between two known ends, a Brownian bridge: at the share u of
    the way the share u (1 - u) of its variance at the end remains. Without a reckoned sample at the newest tick there
    is no closing error, and nothing is put between.
    """
    index = {sample.tick: k for k, sample in enumerate(reckoned)}
    line = reckoned[index.get(samples[0].tick, len(reckoned)) : index.get(since, -1) + 1]  # newest first
    if len(line) < 3:
        return samples
    X_OP = line[-1].X_OS
    steps = [float(np.linalg.norm(a.X_OS[:3, 3] - b.X_OS[:3, 3])) for a, b in pairwise(line)]
    travelled = np.cumsum(steps[::-1])[::-1]  # from the start to each of them
    if not travelled[0] > 0.0:
        return samples
    closing = inverse(X_OP) @ samples[0].X_OS @ inverse(line[0].X_OS) @ X_OP  # error as a motion in P
    measured = samples[0].covariance if samples[0].anchor == since else 0.0 * samples[0].covariance
    corrected = []
    for sample, distance in zip(line[1:-1], travelled[1:], strict=True):
        u = float(distance / travelled[0])
        X_PS = stretched(closing, u) @ inverse(X_OP) @ sample.X_OS
        covariance = u**2 * measured + u * (1.0 - u) * line[0].covariance
        corrected.append(sample._replace(X_OS=chained(X_OP, X_PS), anchor=since, covariance=covariance))
    older = next(k for k, sample in enumerate(samples) if sample.tick <= since)
    return (samples[0], *corrected, *samples[older:])
