"""Warnings about cameras: a right camera that is turned against its calibration, or that exposes at another time."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

from estimators.calibration.self_calibrated_motion import SelfCalibratedMotion
from estimators.estimates import Motion

_FEWEST: Final = 3  # motions; one or two may be a coincidence
_LATE: Final = 4.0  # delay that is warned of [standard deviations]
_LEAST_DELAY: Final = 1e-3  # the same [s]


def calibration_warnings(motions: Iterable[Motion | None], remedy: str) -> tuple[str, ...]:
    """A line for a calibration that is refuted, and one for images that are not taken at the same time.

    Args:
        motions: of one pair of cameras, in order; None where there is none.
        remedy: what turns on self-calibration, in words.
    """
    watched, refuted, late = 0, _Found(), _Found()  # an hour of motions is not held in memory
    for motion in motions:
        if isinstance(motion, SelfCalibratedMotion):
            watched += 1
            refuted = refuted.with_motion(motion) if motion.miscalibrated else refuted
            late = late.with_motion(motion) if abs(motion.right_delay) > _limit(motion) else late
    return (*_of_rotation(refuted, watched, remedy), *_of_delay(late))


class _Found(NamedTuple):
    """Motions of one kind: how many, and the last of them."""

    number: int = 0
    last: SelfCalibratedMotion | None = None

    def with_motion(self, motion: SelfCalibratedMotion) -> _Found:
        """One more."""
        return _Found(self.number + 1, motion)


def _of_rotation(refuted: _Found, watched: int, remedy: str) -> Iterator[str]:
    if refuted.last is not None and refuted.number >= _FEWEST:
        angles = ", ".join(f"{name} {math.degrees(angle):.2f}" for name, angle in refuted.last.right_rotation.named())
        yield (
            f"the right camera is turned against its calibration by {angles} deg, which makes {refuted.number} of "
            f"{watched} motions degraded or lost; calibrate the cameras anew, or {remedy}"
        )


def _of_delay(late: _Found) -> Iterator[str]:
    if late.last is not None and late.number >= _FEWEST:
        delay, std = late.last.right_delay, late.last.right_delay_std
        yield (
            f"the right image is taken {1e3 * abs(delay):.1f} ms {'after' if delay > 0.0 else 'before'} the left one "
            f"(standard deviation {1e3 * std:.1f} ms); trigger both cameras together"
        )


def _limit(motion: SelfCalibratedMotion) -> float:
    return max(_LATE * motion.right_delay_std, _LEAST_DELAY)
