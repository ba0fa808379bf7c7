"""Poses of the trailer body along its way, newest first, and what each was measured from.

Every sample but the first hangs on an older one, its anchor: the sample before it where motions are measured from
frame to frame, a keyframe where they are not. The error between two samples is made of those links alone that lead
from one to the other: a whole chain of frames in the first case, a few keyframes in the second.

The hitch's path leads through the samples as it was travelled forwards. A hitch that goes back takes up its path: the
samples that it has gone back past leave the path, each as soon as the hitch is behind the line that lay across the
trailer there, and the newest sample is joined to the one that it came back to. A keyframe that motions are still
measured from stays among the samples, but beside the path.
"""

from __future__ import annotations

from itertools import islice
from typing import NamedTuple

import numpy as np

from estimators.estimates import Anchor
from estimators.rigid_motion import UncertainMotion, chained, composed
from vehicle.frames import FloatArray, transform

_STEP = 0.02  # samples nearer than this to the next older one are dropped when the next arrives [m]


class Sample(NamedTuple):
    """The body at one tick, and the measurement that placed it there."""

    tick: int
    X_OS: FloatArray  # (4, 4)
    anchor: int  # tick of the sample that it was measured from; its own for the first
    covariance: FloatArray  # (6, 6) of that measurement's errors (d_theta [rad], d_p [m]), along the axes of O
    doubtful: bool  # whether that measurement is degraded or bridged
    on_path: bool = True  # False: a keyframe that the hitch has gone back past
    joined: bool = False  # whether the path was cut behind it, after going back


class Link(NamedTuple):
    """A measurement on the way from the newest sample to an older one."""

    end: int  # index of the sample that it placed
    sense: float  # 1 where its error moves the path behind it, -1 where it moves the older sample itself


def first_sample(tick: int) -> Sample:
    """The sample that a new path begins with; it defines the frame O."""
    return Sample(tick, np.eye(4), tick, np.zeros((6, 6)), False)


def up_to(samples: tuple[Sample, ...], tick: int) -> tuple[Sample, ...]:
    """The samples without any newer than ``tick``; a new path if none is of that tick."""
    kept = tuple(sample for sample in samples if sample.tick <= tick)
    return kept if kept and kept[0].tick == tick else (first_sample(tick),)


def extended(
    samples: tuple[Sample, ...],
    tick: int,
    increment: UncertainMotion,
    doubtful: bool,
    keep_start: bool,
    anchor: Anchor | None = None,
) -> tuple[Sample, ...]:
    """The samples with one more at the end of the increment, measured from the anchor if that is still among them.

    The newest sample so far is dropped if it lies too near to its predecessor, unless it is to be kept: a standstill
    does not fill the chain, and the newest sample is always where the body really is. So are those that the hitch has
    gone back past.
    """
    X_OA = {sample.tick: sample.X_OS for sample in samples}
    measured, origin = increment.covariance, samples[0].tick
    if anchor is not None and anchor.tick in X_OA:
        measured, origin = anchor.covariance, anchor.tick
    R = np.kron(np.eye(2), X_OA[origin][:3, :3])
    end = Sample(tick, chained(samples[0].X_OS, increment.X), origin, R @ measured @ R.T, doubtful)
    if keep_start:
        return (end, *samples)
    keyframe = None if anchor is None else anchor.tick
    return _thinned(_taken_up((end, *samples), keyframe), keyframe)


def rested(
    samples: tuple[Sample, ...], tick: int, covariance: FloatArray, doubtful: bool, keyframe: int | None
) -> tuple[Sample, ...]:
    """The samples with the newest where it is until a later tick, but for errors of this covariance (6, 6)."""
    newest = samples[0]
    R = np.kron(np.eye(2), newest.X_OS[:3, :3])
    end = Sample(tick, newest.X_OS, newest.tick, R @ covariance @ R.T, doubtful)
    return _thinned((end, *samples), keyframe)


def _taken_up(samples: tuple[Sample, ...], keyframe: int | None) -> tuple[Sample, ...]:
    """The samples without those of the path that the newest has gone back past.

    The ``keyframe`` (a tick) that later motions will be measured from only leaves the path. If no more than the last
    but one is passed it may have been noise, and the path is not taken to have been cut.
    """
    place, passed, cut = 1, 0, False
    while place < len(samples) and (not samples[place].on_path or _is_behind(samples[0], samples[place])):
        cut |= samples[place].on_path and (passed > 0 or samples[place].joined)
        passed += samples[place].on_path
        if samples[place].tick == keyframe:
            samples = (*samples[:place], samples[place]._replace(on_path=False), *samples[place + 1 :])
            place += 1
        else:
            samples = _without(samples, place)
    return (samples[0]._replace(joined=True), *samples[1:]) if cut else samples


def _is_behind(sample: Sample, other: Sample) -> bool:
    """Whether the hitch of one sample is behind the line across the trailer of the other."""
    return float((sample.X_OS[:3, 3] - other.X_OS[:3, 3]) @ other.X_OS[:3, 0]) < 0.0


def _thinned(samples: tuple[Sample, ...], keyframe: int | None) -> tuple[Sample, ...]:
    """The samples without the last but one of the path, if it lies too near to the one before it.

    If the last but one is the ``keyframe`` (a tick) that later motions will be measured from, that one goes instead.
    """
    while len(near := _first_of_path(samples)) > 2 and _distance(samples[near[1]], samples[near[2]]) < _STEP:
        samples = _without(samples, near[2] if samples[near[1]].tick == keyframe else near[1])
    return samples


def _first_of_path(samples: tuple[Sample, ...]) -> list[int]:
    """Indices of the newest three samples of the path."""
    return list(islice((k for k, sample in enumerate(samples) if sample.on_path), 3))


def positions_now(samples: tuple[Sample, ...]) -> FloatArray:
    """Hitch positions (n, 3) in the newest S, newest first; de Saxe 2018, eqs 3 to 5."""
    X_OS = samples[0].X_OS
    p_OS = np.array([sample.X_OS[:3, 3] for sample in samples])
    positions: FloatArray = (p_OS - X_OS[:3, 3]) @ X_OS[:3, :3]
    return positions


def links_between(samples: tuple[Sample, ...], older: int) -> tuple[Link, ...]:
    """The measurements that lead from the newest sample to the one with the index ``older``."""
    index = {sample.tick: k for k, sample in enumerate(samples)}
    newest, past = _ancestry(samples, index, 0), _ancestry(samples, index, older)
    shared = set(newest) & set(past)
    own = [Link(k, 1.0) for k in newest if k not in shared]
    return (*own, *(Link(k, -1.0) for k in past if k not in shared))


def _ancestry(samples: tuple[Sample, ...], index: dict[int, int], start: int) -> list[int]:
    """Indices of the sample, its anchor, the anchor's anchor and so on, as far back as there are samples."""
    line = [start]
    while (anchor := samples[line[-1]].anchor) in index and index[anchor] != line[-1]:
        line.append(index[anchor])
    return line


def _without(samples: tuple[Sample, ...], victim: int) -> tuple[Sample, ...]:
    """The samples without one; those measured from it now hang on its own anchor."""
    gone = samples[victim]
    newer = tuple(_rehung(sample, gone) if sample.anchor == gone.tick else sample for sample in samples[:victim])
    return (*newer, *samples[victim + 1 :])


def _rehung(sample: Sample, gone: Sample) -> Sample:
    """The sample, its measurement composed with that of the one which goes."""
    if gone.anchor == gone.tick:  # the first sample had none
        return sample._replace(anchor=sample.tick, covariance=np.zeros((6, 6)), doubtful=False)
    way = transform(np.eye(3), sample.X_OS[:3, 3] - gone.X_OS[:3, 3])  # along the axes of O, as the covariances are
    covariance = composed(
        UncertainMotion(np.eye(4), gone.covariance), UncertainMotion(way, sample.covariance)
    ).covariance
    return sample._replace(anchor=gone.anchor, covariance=covariance, doubtful=sample.doubtful or gone.doubtful)


def _distance(a: Sample, b: Sample) -> float:
    return float(np.linalg.norm(a.X_OS[:3, 3] - b.X_OS[:3, 3]))
