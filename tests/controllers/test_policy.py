"""A trained policy in the loop: it is given there what it was given in its environment."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import offtrack.environments.registry
from controllers.trailer import Actuation, Combination
from controllers.trailer_steering.path_laws import PathPreview
from controllers.trailer_steering.policy import (
    Network,
    Policy,
    TrainedFor,
    feature_names,
    load_network,
    network_file,
    save_network,
    shipped_networks,
)
from offtrack.environments.rewards import DEFAULT_VEHICLE
from offtrack.environments.trailer_steering import TrailerSteering
from offtrack.environments.training.benchmark import driven
from offtrack.environments.training.law_pilot import LawPilot
from offtrack.environments.training.pilots import NetworkPilot, Pilot
from scenarios.assembly.adapters import trailer_geometry
from scenarios.assembly.drivers_and_laws import trailer_law
from scenarios.assembly.surrogate import load_surrogate
from scenarios.assembly.trailer_run import assemble
from scenarios.loop.runner import run
from scenarios.options.scenario import load_scenario
from scenarios.results.metrics import rms
from tests.trailers import estimate, signals
from vehicle.combination.description import load_vehicle

VEHICLE = load_vehicle("uk_longer_semitrailer")
NAMES = feature_names(2, [unit.name for unit in VEHICLE.units])
LAW = "controllers.trailer_steering.policy:Policy"


def network(**gains: tuple[float, float]) -> Network:
    """A linear one with these gains on features, for both axles [1/unit of the feature], over the limit of 30 deg."""
    weights = np.zeros((2, len(NAMES)))
    for name, both in gains.items():
        weights[:, NAMES.index(name)] = np.array(both) / np.radians(30.0)
    return Network((weights,), (np.zeros(2),), np.zeros(len(NAMES)), np.ones(len(NAMES)), NAMES)


# Axles of a trailer that rolls about its middle, 7 m behind the hitch, and 0.2 rad a metre back to the path.
LINEAR = network(articulation_1=(-0.3, -0.5), off_tracking=(0.2, 0.2))


@pytest.mark.slow
def test_a_network_drives_in_the_loop_as_in_its_environment(tmp_path: Path) -> None:
    """The same roundabout with an exact estimate: off-tracking agrees within 3 cm RMS over the run.

    The loop's estimate comes ten times a second and a frame late, the environment's is of now.
    """
    file = tmp_path / "linear.npz"
    save_network(LINEAR, file)
    settings = [f"trailer_steering={LAW}", f"steering.path={file}", "off_tracking=truth", "course.turn_deg=120"]
    settings += ["course.entry=20", "course.exit=10"]
    scenario = load_scenario("roundabout", settings)
    result = run(scenario, 1)
    in_loop = result.log["off_tracking_true"]
    env = gymnasium.make("offtrack/TrailerSteering-v0", observation="truth", courses=(assemble(scenario, 1).course,))
    given = {"friction": 0.8, "cross_fall": 0.0, "speed": 10.0 / 3.6, "load": 1.0, "length": 1.0, "actuator_lag": 1.0}
    seen, _ = env.reset(seed=1, options={**given, "sensor_error": 0.0})
    told = []
    ended = False
    while not ended:
        action = LINEAR(seen.astype(np.float64)).astype(np.float32)
        seen, _, terminated, truncated, info = env.step(action)
        told.append(info["off_tracking"])
        ended = terminated or truncated
    assert result.outcome == info["outcome"] == "completed"
    there = in_loop[2::2][: len(told)]
    of_both = np.isfinite(there)
    assert rms(there) > 0.1  # it is no trivial run
    assert rms(np.array(told)[: len(there)][of_both] - there[of_both]) < 0.03


@pytest.mark.parametrize(("hidden", "limit"), [("tanh", "clip"), ("relu", "tanh")])
def test_a_network_is_read_as_it_was_written(tmp_path: Path, hidden: str, limit: str) -> None:
    """Every array and function, and what it makes of features; functions that are unknown are refused."""
    rng, n = np.random.default_rng(1), len(NAMES)
    weights, biases = (rng.normal(size=(4, n)), rng.normal(size=(2, 4))), (rng.normal(size=4), np.zeros(2))
    domain = TrainedFor((1.0, 5.0), (9.0, 14.0), (0.1, 0.3))
    deep = Network(weights, biases, rng.normal(size=n), np.ones(n), NAMES, hidden, limit, domain)
    save_network(deep, tmp_path / "deep.npz")
    read, x = load_network(tmp_path / "deep.npz"), rng.normal(size=n)
    first = weights[0] @ (x - deep.mean) + biases[0]
    last = weights[1] @ (np.tanh(first) if hidden == "tanh" else np.maximum(first, 0.0))
    expected = np.tanh(last) if limit == "tanh" else np.clip(last, -1.0, 1.0)
    assert read(x) == pytest.approx(expected, rel=1e-12)
    assert read.trained_for == domain
    np.savez(tmp_path / "domain.npz", **dict(np.load(tmp_path / "deep.npz")) | {"domain": np.ones((3, 2)) * [2.0, 1.0]})
    with pytest.raises(ValueError, match="domain must be three rows of a least and a largest number"):
        load_network(tmp_path / "domain.npz")
    save_network(deep._replace(hidden="sin"), tmp_path / "sin.npz")
    arrays = dict(np.load(tmp_path / "deep.npz")) | {"functions": np.array([hidden, limit, "clip"])}
    np.savez(tmp_path / "three.npz", **arrays)
    for name in ("sin.npz", "three.npz"):
        with pytest.raises(ValueError, match="functions must be one of tanh, relu and one of clip, tanh"):
            load_network(tmp_path / name)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (LINEAR._replace(weights=(np.zeros((2, 3)),)), r"W0 of shape \(2, 3\) must be \(2, 18\)"),
        (LINEAR._replace(scale=np.zeros(len(NAMES))), "scale above 1e-09"),
        (LINEAR._replace(biases=(np.array([np.nan, 0.0]),)), "not finite"),
        (
            LINEAR._replace(features=NAMES[1:], mean=np.zeros(17), scale=np.ones(17), weights=(np.zeros((2, 17)),)),
            "reads no off_tracking",
        ),
        (LINEAR._replace(weights=(np.zeros((1, 18)),), biases=(np.zeros(1),)), "steers 1 axles"),
    ],
)
def test_a_network_that_does_not_fit_is_refused_in_one_line(tmp_path: Path, wrong: Network, words: str) -> None:
    save_network(wrong, tmp_path / "wrong.npz")
    with pytest.raises(ValueError, match=words):
        Policy(
            trailer_geometry(VEHICLE, 1),
            combination=Combination(VEHICLE, 1),
            parameters=Policy.Parameters(path=str(tmp_path / "wrong.npz")),
        )


def test_a_file_that_is_no_network_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "text.npz").write_text("not one")
    np.savez(tmp_path / "other.npz", x=np.zeros(3))
    cases = ("none.npz", "cannot be read"), ("text.npz", "cannot be read"), ("other.npz", "has no mean")
    for name, words in (*cases, ("model.zip", "offtrack convert-policy")):
        with pytest.raises(ValueError, match=words):
            load_network(tmp_path / name)


@pytest.mark.parametrize("name", shipped_networks())
def test_outside_of_its_training_path_preview_steers_and_a_line_says_so(name: str) -> None:
    """Beyond its speeds, with actuators slower than any in the training, and on another combination."""
    trailer, combination = trailer_geometry(VEHICLE, 1), Combination(VEHICLE, 1)
    law: Any = trailer_law("policy", trailer, combination, {"path": name}).law
    assert law.gave_way(4.9) == []
    assert law.gave_way(5.4) == [
        "policy is for up to 18 km/h and fades out up to 22 km/h, the drive reached 19 km/h: path_preview steered there"
    ]
    double = load_vehicle("b_double_steered")
    law = trailer_law("policy", trailer_geometry(double, 2), Combination(double, 2), {"path": name}).law
    assert law.gave_way(3.0) == [
        "policy is for another combination than b_double_steered: its network does not read articulation_2, "
        "steer_trailer_3, yaw_rate_lead trailer: path_preview steered"
    ]
    slow = replace(trailer, actuator_lag=0.5)
    law = trailer_law("policy", slow, combination, {"path": name}).law
    assert law.gave_way(3.0) == [
        "policy is for a lag of the actuators of 0.105 to 0.225 s, not of 0.5 s: path_preview steered"
    ]
    aside = np.column_stack([-np.linspace(0.0, 16.0, 60), np.full(60, 0.2)])
    preview, memories = PathPreview(slow), (law.init(), PathPreview(slow).init())
    for tick in range(0, 600, 20):
        seen = estimate(tick - 100, value=0.2, path=aside, v_x=4.0) if tick >= 100 else None
        steps = law.step(memories[0], tick, seen, signals(tick)), preview.step(memories[1], tick, seen, signals(tick))
        memories = steps[0][0], steps[1][0]
        np.testing.assert_array_equal(steps[0][1].angles, steps[1][1].angles)
    assert steps[1][1].angles.any()


@pytest.mark.parametrize(("lag", "same"), [(0.15, False), (0.45, True)])
def test_with_actuators_slower_than_trained_with_path_preview_steers(lag: float, same: bool) -> None:
    """The data sheet says 0.15 s; the network is trained for 0.105 to 0.225 s."""
    trailer, combination = trailer_geometry(VEHICLE, 1), Combination(VEHICLE, 1)
    policy = Policy(trailer, combination=combination, parameters=Policy.Parameters(path=next(iter(shipped_networks()))))
    able, memory = np.ones(len(trailer.straight), bool), policy.init()
    angles, goal = np.zeros(len(able)), np.full(len(able), 0.1)
    for tick in range(0, 1000, 20):
        memory, _ = policy.step(memory, tick, None, replace(signals(tick), angles=angles))
        memory = policy.actuated(memory, Actuation(goal=goal, able=able))
        angles = angles + (goal - angles) * 0.02 / lag
        goal = -goal if tick % 400 == 380 else goal
    aside = np.column_stack([-np.linspace(0.0, 16.0, 60), np.full(60, 0.2)])
    seen = estimate(1000, value=0.2, path=aside, v_x=4.0)
    preview, by_preview = PathPreview(trailer).step(memory.preview, 1020, seen, signals(1020))
    after, command = policy.step(memory, 1020, seen, signals(1020))
    assert (abs(preview.answers.lag(trailer) - trailer.actuator_lag) > 0.1) == same
    assert np.array_equal(command.angles, by_preview.angles) or not same
    assert (after.preview.bias != 0.0) == same


@pytest.mark.slow
@pytest.mark.parametrize("name", shipped_networks())
def test_a_shipped_network_steers_where_it_has_not_been(name: str) -> None:
    """Smooth paths that no training has, friction and speed drawn: a decimetre RMS at most, a linkage has half a metre.

    Its provenance is beside it.
    """
    network = load_network(network_file(name))
    assert network_file(name).with_suffix(".json").is_file()
    env = offtrack.environments.registry.vector(
        "TrailerSteering-v0", 4, courses=("random-110", "random-111"), autoreset_mode="Disabled"
    )
    assert isinstance(env.core, TrailerSteering)
    by_law = LawPilot(env.core, load_vehicle(DEFAULT_VEHICLE), "policy", load_surrogate(), {"path": name})
    drives: list[tuple[Pilot, dict[str, Any]]] = [
        (NetworkPilot(network), {"speed": (3.0, 5.0)}),
        (by_law, {"speed": (3.0, 5.0)}),
        (by_law, {"speed": (4.5, 5.0), "actuator_lag": (1.3, 1.5)}),  # slow axles, near the limits of its domain
    ]
    for pilot, domain in drives:
        for episode in driven(env, pilot, 11, domain):
            assert not episode["mishap"]
            assert episode["true_rms_m"] < 0.1
            assert episode["true_max_m"] < 0.5


def test_a_shipped_network_is_asked_for_by_its_name() -> None:
    name = shipped_networks()[0]
    assert load_scenario("roundabout", [f"policy.path={name}"]).policy.path == name
    assert load_scenario("roundabout", ["policy.path=mine.npz"]).policy.path == str(Path("mine.npz").resolve())
