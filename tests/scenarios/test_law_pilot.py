"""Laws of the scenarios in the environment: they steer as in a scenario."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from offtrack.environments.core import Features, Observation
from offtrack.environments.observations import HitchPaths
from offtrack.environments.registry import vector
from offtrack.environments.training.evaluation import LawPilot
from scenarios.assembly.surrogate import SurrogateParameters
from scenarios.assembly.trailer_run import assemble
from scenarios.loop.trailer_session import TrailerSession
from scenarios.options.scenario import load_scenario
from scenarios.results.metrics import rms, true_off_tracking
from vehicle.combination.description import load_vehicle
from vehicle.frames import FloatArray

EXACT = SurrogateParameters(
    bias=0.0,
    drift=0.0,
    drift_time=1.0,
    noise=0.0,
    loss_rate=0.0,
    loss_duration=0.1,
    velocity_noise=0.0,
    yaw_rate_noise=0.0,
)
NOMINAL = {"friction": 0.8, "cross_fall": 0.0, "speed": 10.0 / 3.6, "load": 1.0, "length": 1.0, "actuator_lag": 1.0}


def features(observation: Observation) -> Features:
    """The observation of an environment without images."""
    assert isinstance(observation, np.ndarray)
    return observation


@pytest.mark.parametrize("law", ["path_preview", "command_steer"])
def test_a_law_steers_as_in_a_scenario(law: str) -> None:
    """A third of the roundabout with an estimate that is exact and a frame late: off-tracking within 1 cm RMS.

    The scenario's path is points a frame apart and its velocities are means over a frame; here they are of now.
    """
    settings = [f"trailer_steering={law}", "off_tracking=truth", "course.turn_deg=120", "signals.noise=0"]
    settings += ["course.entry=20", "course.exit=10"]
    parts = assemble(load_scenario("roundabout", settings), 1)
    session = TrailerSession(parts)
    while session.outcome is None:
        session.advance()
    session.close()
    x, y, psi = np.array([row.truth.poses[1] for row in session.rows]).T
    in_scenario = true_off_tracking(x, y, psi, 14.0)
    env = vector("TrailerSteering-v0", 1, courses=(parts.course,), surrogate=EXACT, autoreset_mode="Disabled")
    pilot = LawPilot(env.core, load_vehicle("uk_longer_semitrailer"), law, EXACT)  # type: ignore[arg-type]
    seen, _ = env.reset(seed=1, options={**NOMINAL, "sensor_error": 0.0})
    pilot.begin(features(seen))
    told, ended = [], False
    while not ended:
        seen, _, terminated, truncated, info = env.step(pilot.act(features(seen), np.ones(1, dtype=bool)))
        told.append(info["off_tracking"][0])
        ended = bool(terminated[0] | truncated[0])
    there = in_scenario[2::2][: len(told)]
    both = np.isfinite(there)
    assert rms(there) > (0.003 if law == "path_preview" else 0.3)
    assert rms(np.array(told)[: len(there)][both] - there[both]) < 0.01


def test_errors_of_the_estimate_reach_the_law() -> None:
    """It steers to where the estimate says that the path is: decimetres beside it, by a bias that is drawn."""
    biased = replace(EXACT, bias=0.25)
    env = vector("TrailerSteering-v0", 1, surrogate=biased, courses=("turn-90",), autoreset_mode="Disabled")
    pilot = LawPilot(env.core, load_vehicle("uk_longer_semitrailer"), "path_preview", biased)  # type: ignore[arg-type]
    (seen, info), aim = env.reset(seed=3, options={**NOMINAL, "sensor_error": 1.0}), []
    pilot.begin(features(seen))
    for _ in range(500):  # 28 m, straight to the turn
        seen, *_, info = env.step(pilot.act(features(seen), np.ones(1, dtype=bool)))
        aim.append(features(seen)[0, 0] - info["off_tracking"][0])
    bias = float(np.median(aim))
    assert abs(bias) > 0.1
    assert info["off_tracking"][0] == pytest.approx(-bias, abs=0.03)


def test_a_path_is_returned_as_it_was_at_its_mark() -> None:
    """Points of a circle, seen from where the trailer was half a second ago, not from where it is now."""
    radius, paths = 20.0, HitchPaths(1, 14.0)

    def pose(angle: float) -> FloatArray:
        return np.array([[radius * math.sin(angle), radius * (1.0 - math.cos(angle)), angle]])

    paths.begin(np.arange(1), pose(0.0), np.array([14.0]))
    angles = np.arange(1, 600) * 0.05 / radius
    for angle in angles[:-25]:
        paths.step(pose(float(angle)))
    mark = paths.mark()
    for angle in angles[-25:]:
        paths.step(pose(float(angle)))
    seen = paths.behind(0, mark, 12.0)
    assert np.array_equal(seen[0], [0.0, 0.0])
    assert seen[1:, 0].max() <= 0.0
    assert -12.0 <= seen[-1, 0] < -11.8
    distance = np.hypot(seen[:, 0], seen[:, 1] - radius)  # the circle's centre is square to the left
    assert distance == pytest.approx(np.full(len(seen), radius), abs=1e-3)
    assert np.hypot(*np.diff(seen[1:], axis=0).T) == pytest.approx(0.1, abs=1e-3)
