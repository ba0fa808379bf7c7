"""Backwards along a path: geometry of a rolling chain, the reference that it leaves, and the law that keeps to it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from controllers.reversing_law import ReverseReference, ReversingLaw, RollingChain
from vehicle.combination.description import load_vehicle
from vehicle.frames import FloatArray, Pose2

ONE = RollingChain(wheelbase=3.8, max_steer=0.7, hitches=(0.6,), lengths=(8.0,))
TWO = RollingChain(wheelbase=3.8, max_steer=0.7, hitches=(0.6, -1.5), lengths=(7.5, 6.0))
CHAINS = pytest.mark.parametrize("chain", [ONE, TWO], ids=["semi-trailer", "two trailers"])


def rolled(chain: RollingChain, state: FloatArray, curvature: float, way: float) -> FloatArray:
    """State x, y, psi (N + 1,) after ``way`` [m] of the tractor's axle, backwards below 0; midpoint rule."""

    def rate(s: FloatArray) -> FloatArray:
        yaw_rates = chain.rates(s[2:-1] - s[3:], curvature)[1]
        return np.concatenate([[math.cos(s[2]), math.sin(s[2])], yaw_rates])

    return state + way * rate(state + 0.5 * way * rate(state))


def last_axle(chain: RollingChain, state: FloatArray) -> Pose2:
    return chain.last_axle(Pose2(*state[:3]), (state[2:-1] - state[3:]).tolist())


def drawn_forwards(chain: RollingChain, curvatures: FloatArray, step: float = 0.05) -> tuple[FloatArray, FloatArray]:
    """Points of the last axle's way, and the states, when the tractor goes along these curvatures."""
    states = [np.zeros(3 + len(chain.lengths))]
    for curvature in curvatures:
        states.append(rolled(chain, states[-1], curvature, step))
    return np.array([last_axle(chain, s)[:2] for s in states]), np.array(states)


def pushed_back(
    chain: RollingChain, reference: ReverseReference, state: FloatArray, way: float, step: float = 0.04
) -> FloatArray:
    """Distance beside the reference and articulation while the law steers backwards, (n, 2)."""
    law, last = ReversingLaw(chain), last_axle(chain, state)
    station, seen = reference.project(last.x, last.y, reference.stations[-1]), []
    for _ in range(round(way / step)):
        last = last_axle(chain, state)
        station = reference.project(last.x, last.y, station)
        on = reference.at(station)
        gamma = state[2:-1] - state[3:]
        x, y, psi = on.pose
        seen.append([math.cos(psi) * (last.y - y) - math.sin(psi) * (last.x - x), np.abs(gamma).max()])
        steer = law.steer(last, gamma, on)
        assert abs(steer) <= chain.max_steer
        state = rolled(chain, state, math.tan(steer) / chain.wheelbase, -step)
    return np.array(seen)


@CHAINS
@pytest.mark.parametrize("curvature", [0.06, -0.03])
def test_a_steady_turn_keeps_its_articulation(chain: RollingChain, curvature: float) -> None:
    """All units then turn at the same rate, and the last axle on the curvature asked for."""
    articulation, of_tractor = chain.steady(curvature)
    speeds, yaw_rates = chain.rates(articulation, of_tractor)
    np.testing.assert_allclose(yaw_rates, of_tractor, rtol=1e-12)  # a closed form, to rounding
    assert yaw_rates[-1] / speeds[-1] == pytest.approx(curvature, rel=1e-12)


def test_a_group_rolls_about_the_root_of_its_second_moment() -> None:
    """Axles at 6.39, 7.70 and 9.01 m: sum x^2 / sum x, 0.15 m behind their middle."""
    chain = RollingChain.of(load_vehicle("eu_tractor_semitrailer"))
    assert chain.lengths == pytest.approx([(6.39**2 + 7.70**2 + 9.01**2) / (6.39 + 7.70 + 9.01)], abs=0.01)


@CHAINS
def test_the_reference_is_how_the_units_stood_on_the_way_there(chain: RollingChain) -> None:
    """Drawn through a bend of 20 m and out of it without slip: articulations and the tractor's curvature come back."""
    entering, turning = np.zeros(300), np.full(500, 0.05)
    ramp = np.linspace(0.0, 0.05, 100)
    curvatures = np.concatenate([entering, ramp, turning, ramp[::-1], entering])
    way, states = drawn_forwards(chain, curvatures)
    reference = ReverseReference.of(chain, way[::5])
    gone = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
    gammas = states[:, 2:-1] - states[:, 3:]
    for k in range(100, len(curvatures) - 100, 50):
        on = reference.at(float(gone[k]))
        np.testing.assert_allclose(on.articulation, gammas[k], atol=0.01)  # smoothing over 0.6 m
        assert on.tractor_curvature == pytest.approx(float(curvatures[k]), abs=0.006)
        assert math.hypot(on.pose.x - way[k, 0], on.pose.y - way[k, 1]) < 0.02


@CHAINS
def test_it_finds_back_to_a_line_from_beside_it(chain: RollingChain) -> None:
    """Two metres beside and askew, on a straight line: within a centimetre after some lengths, never folded."""
    reference = ReverseReference.of(chain, np.array([[-150.0, 0.0], [40.0, 0.0]]))
    state = np.zeros(3 + len(chain.lengths))
    state[1], state[2:] = 2.0, 0.1
    seen = pushed_back(chain, reference, state, 100.0)
    assert abs(seen[-1, 0]) < 0.01
    assert seen[:, 1].max() < math.radians(60.0)
    assert seen[:, 0].min() > -0.5  # it hardly crosses the line


@CHAINS
def test_it_goes_back_through_a_bend_on_its_own_way(chain: RollingChain) -> None:
    """Also at the transition from a bend to a straight, where the articulation changes."""
    curvatures = np.concatenate([np.zeros(300), np.linspace(0.0, 0.06, 60), np.full(400, 0.06)])
    way, states = drawn_forwards(chain, curvatures)
    reference = ReverseReference.of(chain, way[::5])
    seen = pushed_back(chain, reference, states[-1], 25.0)
    assert np.abs(seen[:, 0]).max() < 0.05


def test_without_feedback_the_same_push_folds() -> None:
    """That the law has something to do: the reference's own steer angle alone loses the trailer within 60 m."""
    reference = ReverseReference.of(ONE, np.array([[-150.0, 0.0], [40.0, 0.0]]))
    assert reference.at(10.0).tractor_curvature == pytest.approx(0.0, abs=1e-9)
    state = np.array([0.0, 0.0, 0.02, 0.0])
    for _ in range(1500):
        state = rolled(ONE, state, 0.0, -0.04)
    assert abs(state[2] - state[3]) > 0.5 * math.pi


def test_a_way_needs_a_metre() -> None:
    with pytest.raises(ValueError, match=r"points span 0\.50 m: reversing needs 1 m at least"):
        ReverseReference.of(ONE, np.array([[0.0, 0.0], [0.5, 0.0]]))


def test_a_tractor_alone_pushes_nothing() -> None:
    with pytest.raises(ValueError, match="must be a tractor with steering that tows a trailer"):
        RollingChain.of(load_vehicle("rigid_truck"))
