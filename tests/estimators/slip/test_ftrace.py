"""FTrace (Reina 2008) on drawn ruts whose pose is known: no renderer, no sand."""

import functools
import math
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators.estimates import Health, SlipAngle
from estimators.slip.wheel_trace.ftrace import (
    BREAKPOINTS,
    STEEPEST,
    FTrace,
    GroundLines,
    Heading,
    Pointing,
    TraceEdges,
    body_slip,
    canny_thresholds,
    confidence,
    ground_mask,
    mean_steer,
    rate_of_turn,
    strongest_lines,
    upright,
    with_pointing,
)
from sensors.messages import GreyImage, RoverView
from sensors.sand.trace_rig import nominal_rig
from vehicle.frames import FloatArray
from vehicle.rover.description import load_rover

ROVER = load_rover("el_dorado_ii")
RIG = nominal_rig(ROVER)
SPEED = 0.08  # [m/s]


@functools.cache
def seen_ground() -> tuple[FloatArray, FloatArray]:
    """Ground positions of all pixels: x, y from the wheel's centre B [m]."""
    camera = RIG.camera
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].astype(float)
    rays = camera.rays(np.stack([u, v], axis=-1))
    to_ground = np.linalg.inv(RIG.image_of_ground()) @ camera.matrix
    ground = np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1) @ to_ground.T
    return ground[..., 0] / ground[..., 2] - RIG.wheel[0], ground[..., 1] / ground[..., 2] - RIG.wheel[1]


@functools.cache
def rut(theta: float, beside: float = 0.0, present: bool = True, seed: int = 0) -> GreyImage:
    """A flat grey ground with a darker band, a wheel wide, that comes to the wheel along theta [rad] in R."""
    rng = np.random.default_rng(seed)
    x, y = seen_ground()
    off = -math.sin(theta) * x + math.cos(theta) * (y - beside)
    inside = np.clip((0.5 * RIG.wheel_width + 0.01 - np.abs(off)) / 0.004, 0.0, 1.0)
    grey = 140.0 - (70.0 * inside if present else 0.0) + rng.normal(0.0, 2.0, off.shape)
    grey[:8, :8] = 20.0  # a dark stone: eqs 3 and 4 live on the range of grey levels
    return np.clip(grey, 0.0, 255.0).astype(np.uint8)


def view(image: GreyImage, k: int = 0, heading: float = 0.0, steer: float = 0.0) -> RoverView:
    """Image k of a rover that goes straight ahead by its wheels."""
    speeds = np.full(4, SPEED / math.cos(steer) / RIG.wheel_radius)
    return RoverView(tick=200 * k, image=image, heading=heading, wheel_speeds=speeds, steer=np.full(4, steer))


def last(views: Sequence[RoverView]) -> SlipAngle:
    ftrace = FTrace(RIG)
    memory = ftrace.init()
    for one in views:
        memory, estimate = ftrace.step(memory, one)
    return estimate


@pytest.mark.parametrize("slip_deg", [-8.0, -3.0, 0.0, 3.0, 8.0])
def test_slip_of_a_straight_trace_is_read_through_the_lens(slip_deg: float) -> None:
    """A rut along the slip angle; Hough's bins of 1 deg and edges of 1 mm allow 0.7 deg and 8 mm."""
    got = last([view(rut(math.radians(slip_deg)), k) for k in range(2)])
    assert got.health is Health.OK
    assert math.degrees(got.wheel_slip) == pytest.approx(slip_deg, abs=0.7)
    assert got.value == pytest.approx(got.wheel_slip, abs=1e-12)  # no turn, no steer: eq. 2 adds nothing
    assert abs(got.trace_offset) < 0.008


def test_bare_ground_has_no_trace() -> None:
    """Nothing is said, and it is said that nothing is known."""
    got = last([view(rut(0.0, present=False))])
    assert (got.health, got.value, got.std) == (Health.LOST, 0.0, math.inf)


def test_rut_that_does_not_come_from_the_wheel_is_no_trace() -> None:
    """A foreign imprint 0.25 m aside fails the condition of Fig. 4: the trace passes through B."""
    assert last([view(rut(0.0, beside=0.25))]).health is Health.LOST


def test_sigma_knows_that_a_line_misreads_a_bend() -> None:
    """On a radius of 2 m the chord of 0.6 m of trace is off by half of 0.3 rad; on a straight 1.4 deg hold."""
    turning = last([view(rut(0.0), k, heading=0.2 * SPEED / 2.0 * k) for k in range(15)])
    assert turning.std == pytest.approx(0.5 * 0.6 / 2.0, rel=0.1)
    assert last([view(rut(0.0), k) for k in range(15)]).std == pytest.approx(math.radians(1.4), rel=1e-6)


def test_steer_angle_is_taken_off_the_trace() -> None:
    """A wheel that points along its own way does not slip, the body goes aslant all the same."""
    got = last([view(rut(math.radians(6.0)), k, steer=math.radians(6.0)) for k in range(2)])
    assert math.degrees(got.wheel_slip) == pytest.approx(0.0, abs=0.7)  # Hough's bins
    assert math.degrees(got.value) == pytest.approx(6.0, abs=0.7)


def test_slip_of_a_steered_wheel_is_against_where_it_pointed_when_it_made_the_trace() -> None:
    """A wheel turned only now has left its trace straight behind: no slip, and the body still goes as the trace lies.

    2 m were rolled straight before, much more than is in view; the trace is known to Hough's bins.
    """
    straight = [view(rut(0.0), k) for k in range(125)]
    ftrace = FTrace(RIG)
    memory = ftrace.init()
    for one in straight[::5]:  # encoders count on between images that were left out
        memory, _ = ftrace.step(memory, one)
    _, got = ftrace.step(memory, view(rut(0.0), 125, steer=0.3))
    assert got.wheel_slip == pytest.approx(0.0, abs=math.radians(0.7))
    assert got.value == pytest.approx(got.wheel_slip, abs=1e-9)  # 0.3 rad of now are not in the trace


def test_pointing_is_averaged_over_the_way_behind_the_wheel() -> None:
    """Half of the way from 0.1 to 0.5 m was made at 0.2 rad; before what is known the first angle goes on."""
    pointings = (Pointing(0.0, 0, 0.0), Pointing(0.7, 1, 0.0), Pointing(0.7, 2, 0.2), Pointing(1.0, 3, 0.2))
    assert mean_steer(pointings, 0.1, 0.5) == pytest.approx(0.1, abs=0.2 / 25)  # one of 25 places looked up
    assert mean_steer(pointings[-1:], 0.1, 0.5) == pytest.approx(0.2, abs=1e-12)
    rolled = with_pointing((Pointing(1.0, 0, 0.0),), replace(view(rut(0.0), steer=0.2), tick=500), RIG, 1.0)
    assert [one.distance for one in rolled] == pytest.approx([1.0, 1.0 + 0.5 * SPEED / math.cos(0.2)])


def test_estimate_is_a_mean_over_the_way_in_view() -> None:
    """The upper edge of the image sees 0.60 m behind the camera's nearer edge (Reina 2008), the wheel is before it."""
    assert 0.55 < last([view(rut(0.0))]).averaged_over < 0.70


def test_turning_adds_the_rear_axles_way_round() -> None:
    """Eq. 2: beta = alpha_r + b r / V_x, here 0.3 m x 0.02 rad/s / 0.08 m/s; the rear axle swings out to the right."""
    image = rut(0.0)
    turning = [view(image, k, heading=0.02 * 0.2 * k) for k in range(25)]
    straight = last([view(image, k) for k in range(25)])
    added = last(turning).value - straight.value
    assert added == pytest.approx(0.5 * RIG.wheelbase * 0.02 / SPEED, rel=0.01)  # linearised against atan


def test_standing_rover_has_no_radius_of_turn() -> None:
    """b / R is left out where V_x / r says nothing."""
    assert body_slip(0.1, 0.0, 0.001, 0.02, 0.3) == pytest.approx(0.1, abs=1e-12)


def test_rate_of_turn_survives_the_compass_going_round() -> None:
    """A line through the headings; too short a time gives none."""
    headings = [Heading(0.2 * k, 3.0 + 0.05 * 0.2 * k) for k in range(21)]
    assert rate_of_turn(headings) == pytest.approx(0.05, abs=1e-12)
    assert rate_of_turn(headings[:5]) == 0.0
    wrapped = last([view(rut(0.0), k, heading=math.remainder(3.1 + 0.004 * k, math.tau)) for k in range(25)])
    plain = last([view(rut(0.0), k, heading=0.004 * k) for k in range(25)])
    assert wrapped.value == pytest.approx(plain.value, abs=1e-9)


def test_thresholds_are_those_of_the_paper() -> None:
    """Eqs 3 and 4: a third of the range of grey levels, and 2.5 times that."""
    image = np.array([[10, 40], [70, 100]], dtype=np.uint8)
    assert canny_thresholds(image) == (30.0, 75.0)


def test_the_wheels_own_edges_are_no_trace() -> None:
    """The wheel is as wide as its trace and points through B: its picture is masked, ground beside it is not."""
    mask = ground_mask(RIG, 0.0)
    assert not mask[470, 320]  # the wheel's middle, at the lower edge of the image
    assert mask[470, 100]
    assert mask[200, 320]
    assert 0.01 < 1.0 - (mask > 0).mean() < 0.1  # it hides some per cent of the image
    wheel = np.full((480, 640), 140, np.uint8)
    wheel[cv2.dilate(mask, np.ones((19, 19), np.uint8)) == 0] = 30  # without the margin of 9 px around it
    assert not TraceEdges(RIG).find(wheel, 0.0)[420:].any()


@pytest.mark.parametrize("steer", [-0.4, 0.4])
def test_a_steered_wheel_is_masked_where_it_has_turned_to(steer: float) -> None:
    """The wheel turns about B: its rear goes to the rover's right when it turns left, which is left in the image."""
    straight, turned = ground_mask(RIG, 0.0) == 0, ground_mask(RIG, steer) == 0
    middles = [float(np.nonzero(mask[440:])[1].mean()) for mask in (straight, turned)]
    assert (middles[1] - middles[0]) / -steer > 3.0 / 0.4  # pixels: the turned hull widens to both sides, too


@given(st.floats(-0.5, 0.5), st.floats(-0.3, 0.3))
def test_lines_go_to_the_image_and_back(theta: float, beside: float) -> None:
    """Image and ground pose are one line in two spaces."""
    lines = GroundLines(RIG)
    d, there, Y = lines.ground(lines.image(np.array([theta]), np.array([beside])))[0]
    x, y = RIG.wheel
    assert (there, Y) == pytest.approx((theta, beside), abs=1e-9)  # rounding of a homography's inverse
    assert d == pytest.approx(math.cos(theta) * (y + beside) - math.sin(theta) * x, abs=1e-9)


@given(st.floats(-0.9 * STEEPEST, 0.9 * STEEPEST), st.floats(150.0, 450.0))
@settings(max_examples=20)
def test_drawn_line_is_the_strongest(phi: float, rho: float) -> None:
    """A line one pixel wide comes first, within two bins of angle and their lever over the image."""
    image = np.zeros((480, 640), np.uint8)
    at = [(rho - v * math.sin(phi)) / math.cos(phi) for v in (0.0, 479.0)]
    if not all(5.0 < u < 634.0 for u in at):
        return
    cv2.line(image, (round(at[0]), 0), (round(at[1]), 479), 255, 1)
    lines = strongest_lines(image, 5, 60)
    assert lines[0, 1] == pytest.approx(phi, abs=math.radians(2.0))
    assert lines[0, 0] == pytest.approx(rho, abs=12.0)
    assert len(lines) <= 5


def test_as_many_lines_are_returned_as_there_are_and_are_asked_for() -> None:
    image = np.zeros((480, 640), np.uint8)
    assert strongest_lines(image, 5, 60).shape == (0, 3)
    image[:, 40::80] = 255
    assert strongest_lines(image, 5, 60).shape == (5, 3)


def test_a_line_has_one_name() -> None:
    """rho, phi and -rho, phi + pi are the same line; the normal form has phi in (-pi/2, pi/2]."""
    same = upright(np.array([[5.0, 3.0], [-5.0, 3.0 - math.pi], [5.0, 0.5 * math.pi]]))
    assert same == pytest.approx(np.array([[-5.0, 3.0 - math.pi], [-5.0, 3.0 - math.pi], [5.0, 0.5 * math.pi]]))


@pytest.mark.parametrize(
    ("conditions", "conclusion"),  # as printed: high, medium and low
    [("SSSSS", 1.0), ("SLSLS", 0.5), ("LSLSL", 0.0), ("LLLLL", 0.0), ("LLSSL", 0.0), ("SSLLS", 0.5), ("SSSSL", 0.0)],
)
def test_every_rule_of_table_1_says_what_it_says(conditions: str, conclusion: float) -> None:
    """Inputs wholly small or large fire one rule, whose conclusion is the confidence; the last ones fire none."""
    inputs = np.array([[0.0 if letter == "S" else 10.0 for letter in conditions]]) * BREAKPOINTS.as_array()
    assert confidence(inputs, BREAKPOINTS)[0] == conclusion


@given(st.lists(st.floats(0.0, 1.0), min_size=5, max_size=5))
def test_confidence_is_between_none_and_full(parts: list[float]) -> None:
    """A number from 0 to 1 for any input; 1 for the line of the image before."""
    got = confidence(np.array([parts]) * BREAKPOINTS.as_array(), BREAKPOINTS)[0]
    assert 0.0 <= got <= 1.0
    assert confidence(np.zeros((1, 5)), BREAKPOINTS)[0] == 1.0


@pytest.mark.parametrize("factor", [0.7, 1.0, 1.4])
def test_breakpoints_may_be_chosen_otherwise(factor: float) -> None:
    """They were never published: what FTrace says of a clear trace must not hang on them."""
    ftrace = FTrace(RIG, BREAKPOINTS.scaled(factor))
    _, got = ftrace.step(ftrace.init(), view(rut(math.radians(5.0))))
    assert got.health is Health.OK
    assert math.degrees(got.wheel_slip) == pytest.approx(5.0, abs=0.7)  # Hough's bins


def test_breakpoint_must_be_positive() -> None:
    """A triangle without width has no slope."""
    with pytest.raises(ValueError, match="positive"):
        BREAKPOINTS.scaled(0.0)


def test_lost_trace_is_found_again_where_a_rover_without_slip_has_it() -> None:
    """After 3 s without a trace the old pose is no reference any more."""
    ftrace = FTrace(RIG)
    memory, _ = ftrace.step(ftrace.init(), view(rut(math.radians(9.0))))
    assert memory.reference is not None
    for k in range(1, 16):
        memory, got = ftrace.step(memory, view(rut(0.0, present=False), k))
        assert got.health is Health.LOST
    assert memory.reference is None
