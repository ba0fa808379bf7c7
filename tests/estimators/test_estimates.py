"""Estimates of one's own parts are what they say, before anything is done with them."""

from dataclasses import replace
from typing import Any

import pytest

from estimators.estimates import CameraOffTracking, Health, OffTracking, check_estimate, lost_motion
from tests.trailers import estimate

KINDS = OffTracking, CameraOffTracking
WRONG: Any = "1 m"


def test_an_estimate_of_another_kind_or_with_fields_of_another_type_is_refused() -> None:
    """One within another one too; whole numbers are numbers."""
    check_estimate(replace(estimate(0), std=1, value=float("nan")), KINDS)
    with pytest.raises(TypeError, match=r"^returned 5, not OffTracking or CameraOffTracking$"):
        check_estimate(5, KINDS)
    for seen in (replace(estimate(0), std=WRONG), replace(estimate(0), health=WRONG), replace(estimate(0), tick=WRONG)):
        for given in (seen, CameraOffTracking(off_tracking=seen, motion=None)):
            with pytest.raises(TypeError, match=r"^returned OffTracking\.(std|health|tick) = '1 m', not"):
                check_estimate(given, KINDS)


def test_a_lost_motion_tells_nothing_but_its_matches() -> None:
    lost = lost_motion(200, 100, 7)
    assert (lost.health, lost.matches, lost.inliers, len(lost.tracks)) == (Health.LOST, 7, 0, 0)
