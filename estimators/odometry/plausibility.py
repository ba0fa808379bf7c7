"""Plausibility of a motion against the last one that was believed.

A vehicle that covers most of the view can be mistaken for the world, and distant scenery agrees with no motion. Such a
motion is a jump of velocity. It is doubted, and believed only if the next motions, measured from the frame that it led
to, go on with the same velocity. A halt takes longer to be believed, as it is what a vehicle close behind looks like.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimators.estimates import Health, Motion, lost_motion
from estimators.rigid_motion import composed, stretched
from vehicle.clock import TICK, to_ticks

HARDEST = 8.0  # acceleration of full braking; vibration of the body reaches half of it [m/s2]
LARGEST_ACCELERATION = 25.0  # of a camera on a trailer, scatter of motions from frame to frame included [m/s2]
# Largest change of velocity while the odometry is lost, as a share of the speed, and its least value. Turning into a
# roundabout changes it by half. A close following vehicle mistaken for the world seems to stop the trailer.
_UNSEEN, _UNSEEN_LEAST = 0.5, 0.5  # [-], [m/s]
_BLIND = 0.5  # a longer motion spans lost frames [s]
_FORGOTTEN = 5.0  # after a longer loss any velocity is accepted [s]
_DOUBTFUL = 0.03  # error of a degraded but correct motion: measured in traffic [m]
_HALTED = 0.25  # share of the last speed below which a motion is a halt
_HALT = to_ticks(1.0, "halt")  # time for which a halt must be seen in good health before it is believed [ticks]


class Doubted(NamedTuple):
    """A motion that is not believed yet."""

    since: int  # tick of the first frame that it was seen in
    total: Motion  # from the last believed frame to the newest one
    newest: Motion  # the last part of it


class Belief(NamedTuple):
    """The last believed motion, and one that is doubted since."""

    last: Motion | None = None
    doubt: Doubted | None = None

    @property
    def newest(self) -> Motion | None:
        """Motion that ended at the newest frame with a motion, believed or not: the best prediction of the next."""
        return self.doubt.newest if self.doubt else self.last


def is_implausible(last: Motion, motion: Motion, hardest: float = LARGEST_ACCELERATION) -> bool:
    """True if the velocity has changed implausibly since the last motion.

    For a degraded motion right after the last one, the limit is the acceleration ``hardest`` [m/s2]. For any motion
    after lost frames, and for a degraded one over them, it is the change of velocity expected during the loss, even if
    braking could explain more.
    """
    span, since = ((motion.tick - tick) * TICK for tick in (motion.previous_tick, last.tick))
    after_loss = motion.previous_tick > last.tick
    believed = motion.health is Health.OK and not after_loss
    if motion.health is Health.LOST or believed or since > _FORGOTTEN:
        return False
    change = hardest * (since - 0.5 * span)  # of the velocity [m/s]
    if after_loss or span > _BLIND:
        change = min(change, max(_UNSEEN * _speed(last), _UNSEEN_LEAST))
    return _jump(last, motion) > _DOUBTFUL + change * span


def doubted(doubt: Doubted | None, motion: Motion) -> Doubted:
    """Doubt after one more motion, which starts where the doubted one ends; None: it is the first."""
    if doubt is None:
        return Doubted(motion.tick, motion, motion)
    return Doubted(doubt.since, _chained(doubt.total, motion), motion)


def believed(belief: Belief, motion: Motion) -> tuple[Belief, Motion]:
    """Belief after a motion from frame to frame, and the motion to report: lost while it is doubted.

    When a doubted motion is confirmed, the report spans all of it.
    """
    last, doubt = belief
    if motion.health is Health.LOST:
        return Belief(last), motion
    if last is None or not is_implausible(last, motion):
        return Belief(motion), motion
    if doubt is not None and is_confirmed(last, doubt, motion):
        return Belief(motion), doubted(doubt, motion).total
    goes_on = doubt is not None and continues(doubt.newest, motion)
    lost = lost_motion(motion.tick, motion.previous_tick, motion.matches)
    return Belief(last, doubted(doubt if goes_on else None, motion)), lost


def is_confirmed(last: Motion, doubt: Doubted, motion: Motion) -> bool:
    """True if a motion, which starts where the doubted one ends, confirms it."""
    if motion.health is Health.LOST or not continues(doubt.newest, motion):
        return False
    if _speed(motion) >= _HALTED * _speed(last):
        return True
    return motion.health is Health.OK and motion.tick - doubt.since >= _HALT


def continues(before: Motion, motion: Motion) -> bool:
    """True if full braking at most lies between two motions of which one starts where the other ends."""
    span, duration = ((one.tick - one.previous_tick) * TICK for one in (motion, before))
    return _jump(before, motion) <= _DOUBTFUL + HARDEST * 0.5 * (span + duration) * span


def _chained(first: Motion, second: Motion) -> Motion:
    """One motion from two that follow each other."""
    X_PC, covariance, common = composed(first.uncertain, second.uncertain)
    keyframe = second.anchor if second.anchor and second.anchor.tick <= first.previous_tick else None
    return replace(
        second, previous_tick=first.previous_tick, X_PC=X_PC, covariance=covariance, common=common, anchor=keyframe
    )


def _jump(before: Motion, motion: Motion) -> float:
    """Distance between the motion and the one at the velocity before [m]."""
    ratio = (motion.tick - motion.previous_tick) / (before.tick - before.previous_tick)
    return float(np.linalg.norm(motion.X_PC[:3, 3] - stretched(before.X_PC, ratio)[:3, 3]))


def _speed(motion: Motion) -> float:
    """Mean speed [m/s]."""
    return float(np.linalg.norm(motion.X_PC[:3, 3])) / ((motion.tick - motion.previous_tick) * TICK)
