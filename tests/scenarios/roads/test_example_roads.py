"""The shipped roads have the sizes that their files and the documentation state."""

from __future__ import annotations

import math

import numpy as np
import pytest

from scenarios.courses import Course
from scenarios.options.scenario import Scenario, load_any_scenario
from vehicle.combination.description import load_vehicle
from vehicle.frames import FloatArray


def course_of(name: str) -> Course:
    scenario = load_any_scenario(name)
    assert isinstance(scenario, Scenario)
    return scenario.course.course(load_vehicle(scenario.vehicle).units[0], scenario.speed)


def curvature(course: Course) -> FloatArray:
    return np.array([course.path.curvature(s) for s in np.arange(0.0, course.length, 0.25)])


def turned(course: Course) -> float:
    """Heading at the end, from that at the start [deg]."""
    return math.degrees(course.path.pose(course.length).psi - course.path.start.psi)


def test_the_depot_is_left_the_way_it_was_entered_round_a_loop_of_11_m() -> None:
    course = course_of("depot")
    assert turned(course) == pytest.approx(180.0, abs=0.1)
    assert np.median(curvature(course)[curvature(course) > 0.05]) == pytest.approx(1.0 / 11.0, rel=0.01)
    assert course.friction is not None
    assert course.relief is not None
    along = course.centreline
    assert course.friction.at(along[:, 0], along[:, 1]).min() == pytest.approx(0.4)


def test_the_mini_roundabout_keeps_the_corner_06_m_inside_a_circle_of_28_m() -> None:
    course = course_of("mini-roundabout")
    assert turned(course) == pytest.approx(-90.0, abs=0.1)
    bends = curvature(course)
    assert np.median(bends[bends < -0.05]) == pytest.approx(-1.0 / 13.4, rel=0.01)
    assert np.median(bends[bends > 0.03]) == pytest.approx(1.0 / 26.2, rel=0.02)
    assert isinstance(course.road_half_width, np.ndarray)
    left, right = course.road_half_width[200:-200].T
    assert left.min() == pytest.approx(0.6, abs=0.03)  # averaged over two metres
    assert right.max() == pytest.approx(13.0, abs=0.05)


def test_the_turbo_roundabout_spirals_from_the_inside_to_the_outside_lane() -> None:
    course = course_of("turbo-roundabout")
    assert turned(course) == pytest.approx(90.0, abs=0.1)
    radii = 1.0 / curvature(course)[curvature(course) > 0.04]
    assert np.percentile(radii, 25) == pytest.approx(0.5 * (12.0 + 17.15), rel=0.01)
    assert np.percentile(radii, 90) == pytest.approx(0.5 * (17.45 + 22.45), rel=0.02)


def test_the_motorway_exit_is_banked_into_its_bend_and_climbs() -> None:
    course = course_of("motorway-exit")
    middle = 0.5 * 4.5  # the driven lane lies inside the bend's reference line
    assert curvature(course).min() == pytest.approx(-1.0 / (60.0 - middle), rel=0.01)
    assert turned(course) == pytest.approx(-math.degrees(110.0 / 60.0 + 1.0), abs=0.1)
    assert course.relief is not None
    line = course.centreline
    tightest = int(np.argmin([course.path.curvature(s) for s in np.arange(0.0, course.length, 0.25)]))
    place, ahead = line[tightest + 160], line[tightest + 164]
    along = (ahead - place) / math.dist(ahead, place)
    left = np.array([-along[1], along[0]])
    points = np.array([place, place + left, place + along])
    heights = course.relief.height(points[:, 0], points[:, 1])
    assert heights[1] - heights[0] == pytest.approx(0.06, abs=0.003)  # the inside, on the right, is lower
    assert heights[2] - heights[0] == pytest.approx(0.04, abs=0.003)
