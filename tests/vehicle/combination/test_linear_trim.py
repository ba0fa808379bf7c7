"""Straight running, and the mirror that parts lateral from longitudinal motion."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from tests.vehicle.chains import with_axles
from vehicle.combination.chain import derivative
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.layout import Chain, Input, State, input_sizes, parts, state_sizes
from vehicle.combination.linear import flipped, kept, straight_running

SPEED = 20.0  # [m/s]


def rate_and_slope(vehicle: Vehicle, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivative of the state, and its jacobian."""
    at, demands = ca.SX.sym("x", x.size), ca.SX.sym("u", u.size)
    s, d = State(*parts(at, state_sizes(vehicle))), Input(*parts(demands, input_sizes(vehicle)))
    rate = ca.vertcat(*derivative(Chain.of(vehicle), s, d))
    value, slope = ca.Function("f", [at, demands], [rate, ca.jacobian(rate, at)])(x, u)
    return np.array(value).ravel(), np.array(slope)


def test_nothing_changes_in_straight_running_but_the_place(chain: Vehicle) -> None:
    """All forces balance: every rate but that of x vanishes, and the speed is the one asked for."""
    x, u = straight_running(chain, SPEED, 0.8)
    s = State(*parts(x, state_sizes(chain)))
    rate = State(*parts(rate_and_slope(chain, x, u)[0], state_sizes(chain)))
    assert s.v_x[0] == SPEED
    assert rate.x[0] == SPEED
    for name, part, value in zip(State._fields, rate, s, strict=True):
        if name != "x":
            # Rounding, times the fastest rates of some 1e3 1/s; hitch forces are of 1e3 N.
            np.testing.assert_allclose(part, 0.0, atol=1e-9 * (1.0 + np.abs(value).max(initial=0.0)), err_msg=name)


def test_the_drive_makes_up_for_rolling_resistance(chain: Vehicle) -> None:
    """The torque that holds the speed would accelerate a vehicle without drag by coefficient times gravity."""
    x, u = straight_running(chain, SPEED, 0.8)
    coefficient = chain.units[0].axles[0].tyre.rolling_resistance
    held = Input(*parts(u, input_sizes(chain))).acceleration[0]
    # Loads move with the pull, and the driven wheels roll a little faster than the vehicle, with a torque of drag.
    assert held == pytest.approx(coefficient * GRAVITY, rel=2e-3)
    assert State(*parts(x, state_sizes(chain))).acceleration[0] == held


def test_the_two_halves_of_the_state_are_all_of_it(chain: Vehicle) -> None:
    """Every coordinate reads its own direction as 1 and all others as 0, and there are as many as states."""
    coordinates = kept(chain) + flipped(chain)
    read = np.stack([c.reading for c in coordinates])
    move = np.column_stack([c.direction for c in coordinates])
    np.testing.assert_array_equal(read @ move, np.eye(sum(state_sizes(chain))))
    assert len({c.name for c in kept(chain)}) == len(kept(chain))
    assert len({c.name for c in flipped(chain)}) == len(flipped(chain))


def test_neither_half_acts_on_the_other(chain: Vehicle) -> None:
    """To first order about straight running: the blocks of the jacobian between the halves are empty."""
    _, slope = rate_and_slope(chain, *straight_running(chain, SPEED, 0.8))
    even, odd = kept(chain), flipped(chain)
    for one, other in ((even, odd), (odd, even)):
        block = np.stack([c.reading for c in one]) @ slope @ np.column_stack([c.direction for c in other])
        # Rounding beside entries of the order of a whole row: hitch forces react by 1e7 N/s per unit of deflection.
        scale = np.abs(np.stack([c.reading for c in one]) @ slope).max(axis=1, keepdims=True)
        assert (np.abs(block) / (1.0 + scale)).max() < 1e-12


@pytest.mark.parametrize("speed", [0.0, -3.0, float("nan")])
def test_straight_running_needs_a_speed(tractor_semitrailer: Vehicle, speed: float) -> None:
    """At rest slip is not defined, and backwards the chain folds: both are refused."""
    with pytest.raises(ValueError, match=r"speed = .* m/s must be positive"):
        straight_running(tractor_semitrailer, speed, 0.8)


def test_a_speed_that_can_not_be_held_is_refused(tractor_semitrailer: Vehicle) -> None:
    """10 kW hold a laden combination at no motorway speed: its drag alone takes 47 kW."""
    weak = tractor_semitrailer.model_copy(
        update={"drive": tractor_semitrailer.drive.model_copy(update={"max_power": 1e4})}
    )
    with pytest.raises(ValueError, match=r"speed = 20.0 m/s cannot be held by eu_tractor_semitrailer"):
        straight_running(weak, SPEED, 0.8)


def test_more_drag_than_grip_is_refused(tractor_semitrailer: Vehicle) -> None:
    """On ice the drive axle, 28 % of the weight, can not pull a drag of 3 %."""
    stuck = with_axles(tractor_semitrailer, tyre={"rolling_resistance": 0.03})
    with pytest.raises(ValueError, match=r"cannot be held .* on a friction of 0.05"):
        straight_running(stuck, 5.0, 0.05)
