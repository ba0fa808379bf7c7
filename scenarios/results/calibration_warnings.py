"""Warnings about cameras: a right camera that is turned against its calibration, or that exposes at another time."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Final

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
    watched = [motion for motion in motions if isinstance(motion, SelfCalibratedMotion)]
    return (*_of_rotation(watched, remedy), *_of_delay(watched))


def _of_rotation(watched: list[SelfCalibratedMotion], remedy: str) -> Iterator[str]:
    refuted = [motion for motion in watched if motion.miscalibrated]
    if len(refuted) >= _FEWEST:
        angles = ", ".join(f"{name} {math.degrees(angle):.2f}" for name, angle in refuted[-1].right_rotation.named())
        yield (
            f"the right camera is turned against its calibration by {angles} deg, which makes {len(refuted)} of "
            f"{len(watched)} motions degraded or lost; calibrate the cameras anew, or {remedy}"
        )


def _of_delay(watched: list[SelfCalibratedMotion]) -> Iterator[str]:
    late = [motion for motion in watched if abs(motion.right_delay) > _limit(motion)]
    if len(late) >= _FEWEST:
        delay, std = late[-1].right_delay, late[-1].right_delay_std
        yield (
            f"the right image is taken {1e3 * abs(delay):.1f} ms {'after' if delay > 0.0 else 'before'} the left one "
            f"(standard deviation {1e3 * std:.1f} ms); trigger both cameras together"
        )


def _limit(motion: SelfCalibratedMotion) -> float:
    return max(_LATE * motion.right_delay_std, _LEAST_DELAY)
