"""The linear-quadratic design of the preview driver, against independent solvers and its own claims."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are

from controllers import preview_design as design
from controllers.tractor import TractorAxle, TractorDynamics, TractorGeometry
from controllers.tractor_model import STATES, path_matrices, tractor_model

DYNAMICS = TractorDynamics(
    mass=8000.0,
    yaw_inertia=28900.0,
    cg_x=2.36,
    hitch_mass=10500.0,
    hitch_x=0.77,
    axles=(
        TractorAxle(3.8, 2.8e5, 0.5, trail=0.04, steer_ratio=1.0),
        TractorAxle(0.0, 5.8e5, 0.5, trail=0.04),
    ),
)
TRACTOR = TractorGeometry(
    wheelbase=3.8, x_ref=5.2, y_ref=0.0, max_steer=0.75, max_steer_rate=0.5, actuator_lag=0.1, dynamics=DYNAMICS
)
FAST = np.geomspace(design.CREEP, design.FASTEST, 24)[-3:]  # speeds of designs, at which nothing is interpolated


def test_the_exponential_is_scipys() -> None:
    """Of a matrix with rates from 1 to 100 per period."""
    A = np.random.default_rng(1).normal(size=(9, 9)) * np.geomspace(0.1, 10.0, 9)
    assert design._exponential(A) == pytest.approx(expm(A), rel=1e-10, abs=1e-10 * np.abs(expm(A)).max())


def test_the_riccati_solution_is_scipys() -> None:
    """An unstable system with a cost on one state only."""
    rng = np.random.default_rng(2)
    A, b, q = rng.normal(size=(6, 6)), rng.normal(size=6), rng.normal(size=6)
    P = solve_discrete_are(A, b[:, None], np.outer(q, q), np.eye(1))
    assert design._riccati(A, np.outer(b, b), np.outer(q, q)) == pytest.approx(P, rel=1e-6, abs=1e-8 * np.abs(P).max())


@pytest.mark.parametrize("speed", FAST.tolist())
def test_a_steady_turn_needs_no_offset(speed: float) -> None:
    """On a path of constant curvature the law asks for the steer angle of the steady turn, with no offset.

    The path counts 3 s ahead; what lies beyond has weights of a hundredth of the sum.
    """
    A, B, E = path_matrices(tractor_model(TRACTOR), TRACTOR, TRACTOR.actuator_lag, speed)
    kappa = 0.1 / speed
    unknowns = np.column_stack([A[:, 1:], B])  # heading error, motion, slips, steer and demand; the offset is zero
    *state, demand = np.linalg.solve(unknowns, -E * kappa).tolist()
    row = design.gains(TRACTOR, 0.6).at(np.array([speed]))[0]
    asked = float(row[STATES:].sum() * kappa - row[1:STATES] @ np.array(state))
    assert asked == pytest.approx(demand, rel=0.02)


def test_a_slow_tractor_is_steered_as_one_that_rolls() -> None:
    """Below 2 m/s slip, side speed and yaw rate are no states of the design."""
    row = design.gains(TRACTOR, 0.6).at(np.array([1.0]))[0]
    assert not row[2:6].any()
    assert row[0] > 0.0
    assert row[1] > 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mass": 0.0}, "mass = 0.0"),
        ({"hitch_mass": -1.0}, "hitch_mass = -1.0 kg"),
        ({"axles": DYNAMICS.axles[:1]}, "axles"),
        ({"axles": (DYNAMICS.axles[0]._replace(stiffness=-1.0), DYNAMICS.axles[1])}, "stiffness = -1.0"),
    ],
)
def test_impossible_dynamics_are_refused(change: dict[str, object], message: str) -> None:
    """By name and value."""
    with pytest.raises(ValueError, match=message):
        replace(DYNAMICS, **change)  # type: ignore[arg-type]
