"""Uncertain motions: composed, seen from elsewhere, stretched."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from estimators.rigid_motion import UncertainMotion, change_frame, composed, inverted, rotation_vector, stretched
from tests.estimators.body_drive import disturbed
from vehicle.frames import FloatArray, inverse, rotation_zyx, transform

SMALL = 1e-6  # step of the numerical derivatives

A_TO_B = transform(rotation_zyx(0.3, 0.02, -0.01), np.array([1.0, -0.4, 0.1]))
B_TO_C = transform(rotation_zyx(-0.7, 0.1, 0.2), np.array([-2.0, 0.7, 0.3]))
CAMERA = transform(rotation_zyx(math.pi, 0.1, 0.0), np.array([-14.0, 0.3, 3.0]))


def difference(X: FloatArray, reference: FloatArray) -> FloatArray:
    """The error (6,) that makes ``reference`` into X."""
    return np.concatenate([rotation_vector(X[:3, :3] @ reference[:3, :3].T), X[:3, 3] - reference[:3, 3]])


def derivative(result: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Jacobian (6, 6) of a motion with respect to the error of one that goes into it."""
    columns = [difference(result(SMALL * axis), result(np.zeros(6))) / SMALL for axis in np.eye(6)]
    return np.column_stack(columns)


def some_covariance(seed: int) -> FloatArray:
    L = np.random.default_rng(seed).standard_normal((6, 6))
    return L @ L.T


@pytest.mark.parametrize("ratio", [0.0, 0.5, 1.0, 2.0, 3.0])
def test_stretched_motion_stays_on_the_circle(ratio: float) -> None:
    """At constant velocity a body goes on along its circle: 5 m/s, 20 deg/s, in 0.1 s."""
    turn, radius = math.radians(2.0), 14.0

    def on_circle(angle: float) -> FloatArray:
        place = np.array([radius * math.sin(angle), radius * (1.0 - math.cos(angle)), 0.0])
        return transform(rotation_zyx(angle, 0.0, 0.0), place)

    X = stretched(on_circle(turn), ratio)
    assert np.allclose(X, on_circle(ratio * turn), rtol=0.0, atol=1e-3)  # [m] R angle^3 / 24, third order


FIRST, SECOND = (UncertainMotion(X, some_covariance(k)) for k, X in enumerate((A_TO_B, B_TO_C)))
RESULTS: dict[str, tuple[UncertainMotion, Callable[[FloatArray, FloatArray], FloatArray], float]] = {
    "composed": (composed(FIRST, SECOND), lambda first, second: first @ second, 1e-3),
    "seen from elsewhere": (change_frame(CAMERA, FIRST), lambda first, _: CAMERA @ first @ inverse(CAMERA), 2e-3),
    "inverted": (inverted(FIRST), lambda first, _: inverse(first), 1e-4),
}  # of FIRST and SECOND, with the motion that it is of exact ones, and O(step)


@pytest.mark.parametrize("case", RESULTS)
def test_covariances_are_those_of_the_differences(case: str) -> None:
    """Also seen from the hitch, 14 m ahead of a camera whose yaw error becomes a lateral one there."""
    result, exact, of_step = RESULTS[case]
    J_1 = derivative(lambda error: exact(disturbed(FIRST.X, error), SECOND.X))
    J_2 = derivative(lambda error: exact(FIRST.X, disturbed(SECOND.X, error)))
    np.testing.assert_allclose(result.X, exact(FIRST.X, SECOND.X), rtol=0.0, atol=1e-12)  # rounding
    expected = J_1 @ FIRST.covariance @ J_1.T + J_2 @ SECOND.covariance @ J_2.T
    assert result.covariance == pytest.approx(expected, rel=1e-5, abs=of_step)  # numbers of order 1 to 100


def test_inverting_twice_changes_nothing() -> None:
    np.testing.assert_allclose(inverted(inverted(FIRST)).covariance, FIRST.covariance, rtol=1e-9, atol=1e-9)
