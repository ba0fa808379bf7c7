"""Uncertain motions: composed, seen from elsewhere, stretched."""

from __future__ import annotations

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


def test_composed_covariance_is_that_of_the_differences() -> None:
    first, second = some_covariance(1), some_covariance(2)
    J_1 = derivative(lambda error: disturbed(A_TO_B, error) @ B_TO_C)
    J_2 = derivative(lambda error: A_TO_B @ disturbed(B_TO_C, error))
    result = composed(UncertainMotion(A_TO_B, first), UncertainMotion(B_TO_C, second))
    assert np.allclose(result.X, A_TO_B @ B_TO_C, rtol=0.0, atol=1e-12)  # rounding
    assert result.covariance == pytest.approx(J_1 @ first @ J_1.T + J_2 @ second @ J_2.T, abs=1e-3)  # O(step)


def test_covariance_seen_from_the_hitch_is_that_of_the_differences() -> None:
    """A camera 14 m behind the hitch: its yaw error becomes a lateral error of the hitch."""
    covariance = some_covariance(3)
    J = derivative(lambda error: CAMERA @ disturbed(B_TO_C, error) @ inverse(CAMERA))
    assert np.abs(J[3:, :3]).max() > 5.0  # [m] the lever is in the case
    result = change_frame(CAMERA, UncertainMotion(B_TO_C, covariance))
    assert np.allclose(result.X, CAMERA @ B_TO_C @ inverse(CAMERA), rtol=0.0, atol=1e-12)
    assert result.covariance == pytest.approx(J @ covariance @ J.T, abs=2e-3)  # O(step), numbers of order 100


@pytest.mark.parametrize("ratio", [0.0, 0.5, 1.0, 2.0, 3.0])
def test_stretched_motion_stays_on_the_circle(ratio: float) -> None:
    """At constant velocity a body goes on along its circle: 5 m/s, 20 deg/s, in 0.1 s."""
    turn, radius = math.radians(2.0), 14.0

    def on_circle(angle: float) -> FloatArray:
        place = np.array([radius * math.sin(angle), radius * (1.0 - math.cos(angle)), 0.0])
        return transform(rotation_zyx(angle, 0.0, 0.0), place)

    X = stretched(on_circle(turn), ratio)
    assert np.allclose(X, on_circle(ratio * turn), rtol=0.0, atol=1e-3)  # [m] R angle^3 / 24, third order


def test_inverted_covariance_is_that_of_the_differences() -> None:
    motion = UncertainMotion(A_TO_B, some_covariance(4))
    J = derivative(lambda error: inverse(disturbed(A_TO_B, error)))
    back = inverted(motion)
    np.testing.assert_allclose(back.X, inverse(A_TO_B), atol=1e-12)  # rounding
    # the step of the derivative is 1e-6
    np.testing.assert_allclose(back.covariance, J @ motion.covariance @ J.T, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(inverted(back).covariance, motion.covariance, rtol=1e-9, atol=1e-9)
