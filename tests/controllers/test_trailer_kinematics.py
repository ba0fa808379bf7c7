"""Axle angles, slip and yaw of a trailer that is led at its hitch."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from controllers.trailer import Linkage
from controllers.trailer_steering.kinematics import AxleGroup
from tests.trailers import ALL_STEERED as TRAILER

ALL_STEERED = AxleGroup.of(TRAILER)
TWO_STEERED = AxleGroup.of(replace(TRAILER, steered=(False, True, True)))
directions = st.floats(-0.8, 0.8)
slips = st.floats(-0.05, 0.05)


@given(st.floats(10.0, 1000.0))
def test_path_following_round_a_circle_has_the_closed_form_angles(radius: float) -> None:
    """Hitch and follow point on R: the axis is a chord, and tan(delta) = -(x - Lf/2)/sqrt(R^2 - Lf^2/4)."""
    half_angle = math.asin(14.0 / (2.0 * radius))
    angles = ALL_STEERED.steer_angles(half_angle, -half_angle, 0.0)
    expected = -(ALL_STEERED.steered - 7.0) / math.sqrt(radius**2 - 49.0)
    assert np.tan(angles) == pytest.approx(expected, abs=1e-12)


@given(directions, directions)
def test_all_axle_lines_meet_in_one_centre(lead: float, follow: float) -> None:
    """No scrub: the normals of all wheels pass through the point where those of hitch and follow point meet."""
    assume(abs(lead - follow) > 1e-2)
    unlimited = replace(TRAILER, max_steer=1.5)
    angles = AxleGroup.of(unlimited).steer_angles(lead, follow, 0.0)
    # A centre at (-c, d) has tan(direction) = (c - x)/d at the distance x behind the hitch.
    d = 14.0 / (math.tan(lead) - math.tan(follow))
    c = d * math.tan(lead)
    assert d * np.tan(angles) == pytest.approx(c - ALL_STEERED.steered, abs=1e-9)


@given(directions, slips, st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(0.5, 10.0))
def test_yaw_follows_from_slip_as_slip_does_from_yaw(lead: float, slip: float, a: float, b: float, v: float) -> None:
    """The two directions of the moment balance are each other's inverse."""
    angles = np.array([a, b])
    yaw_rate = v * TWO_STEERED.yaw_per_metre(lead, float(TWO_STEERED.steer_moment(angles)), slip)
    measured = TWO_STEERED.mean_slip(v * math.cos(lead), v * math.sin(lead), yaw_rate, angles)
    assert measured == pytest.approx(slip, abs=1e-12)


@pytest.mark.parametrize("axles", [ALL_STEERED, TWO_STEERED], ids=["three", "two"])
@given(lead=st.floats(-0.3, 0.3), follow=st.floats(-0.3, 0.3), slip=slips)
def test_steer_angles_send_the_follow_point_where_it_is_wanted(
    axles: AxleGroup, lead: float, follow: float, slip: float
) -> None:
    """Put into the moment balance, slip and fixed axle included, they give the yaw that turns lead into follow."""
    angles = axles.steer_angles(lead, follow, slip)
    assume(np.abs(angles).max() < TRAILER.max_steer - 1e-9)
    yaw_per_metre = axles.yaw_per_metre(lead, float(axles.steer_moment(angles)), slip)
    follow_tangent = math.tan(lead) - 14.0 * yaw_per_metre / math.cos(lead)
    assert follow_tangent == pytest.approx(math.tan(follow), abs=1e-12)


def test_what_an_axle_at_its_limit_lacks_the_others_give() -> None:
    """Coming out of a tight turn with one axle fixed, the last axle would need more than 30 deg; the moment stays."""
    lead, follow = 0.1, -0.57
    angles = TWO_STEERED.steer_angles(lead, follow, 0.0)
    unlimited = AxleGroup.of(replace(TRAILER, steered=(False, True, True), max_steer=1.5))
    asked = unlimited.steer_angles(lead, follow, 0.0)
    assert abs(asked[1]) > TRAILER.max_steer > abs(asked[0])
    assert angles[1] == pytest.approx(-TRAILER.max_steer)
    assert abs(angles[0]) > abs(asked[0])
    assert TWO_STEERED.steer_moment(angles) == pytest.approx(unlimited.steer_moment(asked), abs=1e-12)


@given(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.floats(-1.0, 1.0))
def test_steer_angles_never_exceed_the_limit(lead: float, follow: float, slip: float) -> None:
    """Whatever is asked, even with the hitch going sideways; a rounding is allowed for tan and arctan."""
    assert np.abs(TWO_STEERED.steer_angles(lead, follow, slip)).max() <= TRAILER.max_steer + 1e-15


@given(directions, directions, slips)
def test_mirror_symmetry(lead: float, follow: float, slip: float) -> None:
    """Swapping left and right flips the angles, exactly."""
    angles = TWO_STEERED.steer_angles(lead, follow, slip)
    np.testing.assert_array_equal(TWO_STEERED.steer_angles(-lead, -follow, -slip), -angles)


LINKED = replace(TRAILER, steered=(False, True, True), linkages=(Linkage((0, 1), (0.638, 1.0)),))


def test_groups_and_ratios_say_which_axles_turn_together() -> None:
    """Axles in no linkage have an actuator of their own, with an angle that is theirs."""
    three = replace(TRAILER, linkages=(Linkage((1, 2), (0.5, 1.0)),))
    assert (three.groups, three.steer_ratios) == (((0,), (1, 2)), (1.0, 0.5, 1.0))
    assert (TRAILER.groups, TRAILER.steer_ratios) == (((0,), (1,), (2,)), (1.0, 1.0, 1.0))


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), slips)
def test_linked_axles_turn_in_their_ratio_with_the_moment_asked_for(lead: float, follow: float, slip: float) -> None:
    """One actuator has one angle; at it the trailer turns as it would with an angle for each axle."""
    asked = TWO_STEERED.steer_angles(lead, follow, slip)
    angles = AxleGroup.of(LINKED).steer_angles(lead, follow, slip)
    assert angles[0] == pytest.approx(0.638 * angles[1], abs=1e-15)
    assert abs(angles[1]) <= LINKED.max_steer
    assume(abs(angles[1]) < LINKED.max_steer - 1e-9)
    assert TWO_STEERED.steer_moment(angles) == pytest.approx(TWO_STEERED.steer_moment(asked), abs=1e-9)
