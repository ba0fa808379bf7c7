"""The linear-quadratic design of the preview driver keeps what it claims."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from controllers import preview_law as design
from controllers.tractor import STATES, TractorAxle, TractorDynamics, TractorGeometry, path_matrices, tractor_model

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


@pytest.mark.parametrize("speed", [-1.0, 0.0, 0.2, 0.27, 3.0, 24.99, 45.0, 60.0, float("nan")])
def test_a_row_of_gains_is_that_of_the_table_bit_for_bit(speed: float) -> None:
    """One driver and a thousand environments are steered alike."""
    gains = design.gains(TRACTOR, 0.1)
    assert gains.row(speed) == gains.at(np.array([speed]))[0].tolist()
