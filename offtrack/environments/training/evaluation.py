"""Comparison of a network with steering laws, all in the same episodes outside the training."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import asdict, replace
from typing import Any, Final, NamedTuple, Protocol, cast

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from controllers.trailer_steering.policy import Network
from offtrack.environments import registry
from offtrack.environments.core import Features
from offtrack.environments.domain import Domain
from offtrack.environments.trailer_steering import TrailerSteering
from offtrack.environments.training.law_pilot import LawPilot
from offtrack.environments.training.training_plan import COURSES, DOMAIN, ENVIRONMENT, Plan
from scenarios.assembly.surrogate import load_surrogate
from scenarios.progress import Progress
from vehicle.combination.description import load_vehicle

POLICY: Final = "policy"
LAWS: Final = ("none", "command_steer", "path_preview")
_SEED: Final = 1_000_000  # far from the seeds of training episodes


class Condition(NamedTuple):
    """Kind of episodes."""

    name: str
    words: str  # description
    courses: tuple[str, ...]
    domain: Domain


UNSEEN: Final = ("figure-of-eight", "farm-track", *(f"random-{k}" for k in range(101, 109)))
CONDITIONS: Final = (
    Condition("trained", "courses and conditions of the training", COURSES, DOMAIN),
    Condition("courses", "a figure of eight, a farm track, eight other smooth paths", UNSEEN, DOMAIN),
    Condition("friction", "friction 0.2 to 0.3; training from 0.3 on", COURSES, replace(DOMAIN, friction=(0.2, 0.3))),
    Condition("speed", "5 to 5.6 m/s; training up to 5 m/s", COURSES, replace(DOMAIN, speed=(5.0, 5.6))),
)


class Score(NamedTuple):
    """Results of one law in the episodes of one condition."""

    rms_m: float  # of the episodes' off-tracking, root of the mean square
    median_rms_m: float
    max_m: float  # largest off-tracking of all episodes
    outside_max_m: float  # largest distance of the follow point to the outside of a turn, of all episodes
    mishaps: int  # episodes that ended in a mishap


class _Pilot(Protocol):
    """Steers the trailers of all episodes."""

    def begin(self, observation: Features) -> None:
        """Start new episodes."""

    def act(self, observation: Features, active: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Actions for all episodes; those of finished episodes are ignored."""


class NetworkPilot:
    """A network that steers all episodes."""

    def __init__(self, network: Network) -> None:
        self._network = network

    def begin(self, observation: Features) -> None:
        """Do nothing: the network has no memory."""

    def act(self, observation: Features, active: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Actions of the network."""
        return self._network(observation.astype(np.float64)).astype(np.float32)


def evaluate(plan: Plan, network: Network, episodes: int, progress: Progress) -> dict[str, dict[str, Score]]:
    """Scores by condition and law, the network first, over this number of episodes each.

    Raises:
        ValueError: one line, if a law can not steer this vehicle.
    """
    scores: dict[str, dict[str, Score]] = {}
    laws = (POLICY, *LAWS)
    for condition in CONDITIONS:
        scores[condition.name] = {}
        for law in laws:
            progress(sum(map(len, scores.values())), len(CONDITIONS) * len(laws), f"{condition.name}, {law}")
            scores[condition.name][law] = scored(plan, condition, law, network, episodes)
    progress(1, 1)
    return scores


def scored(plan: Plan, condition: Condition, law: str, network: Network, episodes: int) -> Score:
    """Score of one law, or of the network, in one condition."""
    env = registry.vector(
        ENVIRONMENT,
        episodes,
        observation=plan.observation,
        vehicle=plan.vehicle,
        courses=condition.courses,
        domain=condition.domain,
        autoreset_mode=AutoresetMode.DISABLED,
    )
    with ExitStack() as cleanup:
        cleanup.callback(env.close)
        core = cast(TrailerSteering, env.core)
        pilot: _Pilot = NetworkPilot(network)
        if law != POLICY:
            pilot = cleanup.enter_context(closing(LawPilot(core, load_vehicle(plan.vehicle), law, load_surrogate())))
        return _score(driven(env, pilot, _SEED + plan.seed))


def driven(env: Any, pilot: _Pilot, seed: int, options: dict[str, Any] | None = None) -> list[dict[str, Any]]:
    """Info at the end of one episode of every sub-environment."""
    observation, _ = env.reset(seed=seed, options=options)
    pilot.begin(observation)
    ended: dict[int, dict[str, Any]] = {}
    active = np.ones(env.num_envs, dtype=bool)
    while active.any():
        observation, _, terminated, truncated, info = env.step(pilot.act(observation, active))
        done = active & (terminated | truncated)
        for k in np.flatnonzero(done).tolist():
            ended[k] = {name: values[k] for name, values in info.items() if not name.startswith("_")}
            ended[k]["mishap"] = bool(terminated[k])
        active &= ~done
    return [ended[k] for k in range(env.num_envs)]


def _score(episodes: Sequence[dict[str, Any]]) -> Score:
    rms = np.array([episode["true_rms_m"] for episode in episodes])
    return Score(
        rms_m=float(np.sqrt(np.mean(rms**2))),
        median_rms_m=float(np.median(rms)),
        max_m=float(max(episode["true_max_m"] for episode in episodes)),
        outside_max_m=float(max(episode["outside_max_m"] for episode in episodes)),
        mishaps=sum(episode["mishap"] for episode in episodes),
    )


def described() -> list[dict[str, Any]]:
    """The conditions for JSON."""
    return [
        {"name": c.name, "words": c.words, "courses": list(c.courses), "domain": asdict(c.domain)} for c in CONDITIONS
    ]
