"""Claims that hold for several laws, without their safeguards."""

from __future__ import annotations

import inspect
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from controllers.trailer import Linkage, TrailerGeometry
from scenarios.catalogue import TRAILER_STEERING, resolve
from tests.trailers import ALL_STEERED, COMBINATION, TWO_OF_THREE, estimate, signals
from vehicle.frames import FloatArray

X = -np.linspace(0.0, 16.0, 60)
by_estimates = pytest.mark.parametrize("name", ["path_preview", "virtual_driver", "mpc"])


def constructed(name: str, trailer: TrailerGeometry) -> Any:
    part = resolve("trailer_steering", name, TRAILER_STEERING)
    keywords = {"combination": COMBINATION} if "combination" in inspect.signature(part).parameters else {}
    return part(trailer, **keywords)


def commands(
    name: str, trailer: TrailerGeometry, offset: float, *, stands_from: int = 99999, then: float = 0.0
) -> FloatArray:
    """Angles (n, axles) [rad] of 1.2 s, with the path ``offset`` to the left of the follow point, 0.1 s old."""
    law, path = constructed(name, trailer), np.column_stack([X, -offset * X / 14.0])
    memory, angles, found, newest = law.init(), np.zeros(sum(trailer.steered)), [], None
    for tick in range(0, 1200, 20):
        speed = 2.8 if tick < stands_from else then
        if tick % 100 == 0 and tick:
            newest = estimate(tick - 100, value=offset, path=path, v_x=speed)
        memory, command = law.step(memory, tick, newest, signals(tick, angles=angles, speed=speed))
        angles = command.angles
        found.append(angles)
    return np.array(found)


@by_estimates
def test_a_path_to_the_left_turns_the_rear_to_the_left(name: str) -> None:
    """All axles push to the left: steered left, for those of a common centre the farther back the more."""
    angles = commands(name, ALL_STEERED if name == "path_preview" else TWO_OF_THREE, 0.2)[20]
    assert (angles > 0.0).all()
    if name in ("path_preview", "virtual_driver"):
        assert (np.diff(angles) > 0.0).all()


@by_estimates
def test_linked_axles_keep_their_ratio_within_the_actuators_limits(name: str) -> None:
    """Two axles on one actuator, the second at 1.4 of its angle: rate and angle are the actuator's."""
    linked = replace(TWO_OF_THREE, linkages=(Linkage((0, 1), (1.0, 1.4)),))
    angles = commands(name, linked, 0.5)
    np.testing.assert_allclose(angles[:, 1], 1.4 * angles[:, 0], atol=1e-12)
    assert np.abs(angles).max() > 0.01
    assert np.abs(np.diff(angles[:, 0])).max() <= linked.max_steer_rate * 0.02 * (1.0 + 1e-9)


@pytest.mark.parametrize(
    ("name", "speed"),
    [("path_preview", 0.1), ("path_preview", 0.0), ("path_preview", -2.0), ("virtual_driver", 0.0), ("mpc", 0.0)],
)
def test_the_axles_stay_where_they_are_when_the_trailer_does_not_roll_forwards(name: str, speed: float) -> None:
    """Turning the wheels on the spot would only wear them; one step may pass before the standstill is known."""
    angles = commands(name, TWO_OF_THREE, 0.2, stands_from=600, then=speed)
    np.testing.assert_array_equal(angles[-1], angles[40])
    assert angles[-1] == pytest.approx(angles[30], abs=0.05)


@pytest.mark.parametrize("name", sorted(set(TRAILER_STEERING) - {"none", "policy"}))
def test_a_trailer_without_steered_axles_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="no steered axle"):
        constructed(name, replace(TWO_OF_THREE, steered=(False,) * 3))
