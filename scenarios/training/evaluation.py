"""A network beside the laws that are there, in episodes that it was not trained in, all with the same ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any, Final, NamedTuple, Protocol, cast

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from controllers.trailer_steering.policy import Network
from scenarios import gym_env
from scenarios.environments.core import Features
from scenarios.environments.domain import Domain
from scenarios.environments.law_pilot import LawPilot
from scenarios.environments.surrogate import load_surrogate
from scenarios.environments.trailer_steering import TrailerSteering
from scenarios.progress import Progress
from scenarios.training.plan import COURSES, DOMAIN, ENVIRONMENT, Plan
from vehicle.combination.description import load_vehicle

POLICY: Final = "policy"
LAWS: Final = ("none", "command_steer", "path_preview")
_SEED: Final = 1_000_000  # far from those that episodes of a training begin with


class Condition(NamedTuple):
    """Episodes of one kind."""

    name: str
    words: str  # what is special about it
    courses: tuple[str, ...]
    domain: Domain


UNSEEN: Final = ("figure-of-eight", "farm-track", *(f"random-{k}" for k in range(101, 109)))
CONDITIONS: Final = (
    Condition("trained", "courses and circumstances of the training", COURSES, DOMAIN),
    Condition("courses", "a figure of eight, a farm track, eight other smooth paths", UNSEEN, DOMAIN),
    Condition("friction", "friction 0.2 to 0.3, trained from 0.3 on", COURSES, replace(DOMAIN, friction=(0.2, 0.3))),
    Condition("speed", "5 to 5.6 m/s, trained to 5 m/s", COURSES, replace(DOMAIN, speed=(5.0, 5.6))),
)


class Score(NamedTuple):
    """What one law has come to in the episodes of one condition."""

    rms_m: float  # of the episodes' off-tracking, root of the mean square
    median_rms_m: float
    max_m: float  # the farthest of all
    outside_max_m: float  # the follow point's largest distance to the outside of a turn, of all
    mishaps: int  # episodes that ended badly


class _Pilot(Protocol):
    """Who steers."""

    def begin(self, seen: Features) -> None:
        """New episodes."""

    def act(self, seen: Features, going: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Actions; those of episodes that are not going on do not count."""


class NetworkPilot:
    """A network that steers all episodes."""

    def __init__(self, network: Network) -> None:
        self._network = network

    def begin(self, seen: Features) -> None:
        """Nothing is remembered."""

    def act(self, seen: Features, going: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Its actions."""
        return self._network(seen.astype(np.float64)).astype(np.float32)


def evaluate(plan: Plan, network: Network, episodes: int, progress: Progress) -> dict[str, dict[str, Score]]:
    """Scores by condition and law, the network's first, over so many episodes each.

    Raises:
        ValueError: one line, if a law can not steer this vehicle.
    """
    found: dict[str, dict[str, Score]] = {}
    laws = (POLICY, *LAWS)
    for condition in CONDITIONS:
        found[condition.name] = {}
        for law in laws:
            progress(sum(map(len, found.values())), len(CONDITIONS) * len(laws), f"{condition.name}, {law}")
            found[condition.name][law] = scored(plan, condition, law, network, episodes)
    progress(1, 1)
    return found


def scored(plan: Plan, condition: Condition, law: str, network: Network, episodes: int) -> Score:
    """Of one law, or of the network, in one condition."""
    env = gym_env.vector(
        ENVIRONMENT,
        episodes,
        observation=plan.observation,
        vehicle=plan.vehicle,
        courses=condition.courses,
        domain=condition.domain,
        autoreset_mode=AutoresetMode.DISABLED,
    )
    try:
        core = cast(TrailerSteering, env.core)
        pilot: _Pilot = NetworkPilot(network)
        if law != POLICY:
            pilot = LawPilot(core, load_vehicle(plan.vehicle), law, load_surrogate())
        return _score(driven(env, pilot, _SEED + plan.seed))
    finally:
        env.close()


def driven(env: Any, pilot: _Pilot, seed: int, options: dict[str, Any] | None = None) -> list[dict[str, Any]]:
    """What the info says at the end of one episode of every sub-environment."""
    seen, _ = env.reset(seed=seed, options=options)
    pilot.begin(seen)
    ended: dict[int, dict[str, Any]] = {}
    going = np.ones(env.num_envs, dtype=bool)
    while going.any():
        seen, _, terminated, truncated, info = env.step(pilot.act(seen, going))
        done = going & (terminated | truncated)
        for k in np.flatnonzero(done).tolist():
            ended[k] = {name: values[k] for name, values in info.items() if not name.startswith("_")}
            ended[k]["mishap"] = bool(terminated[k])
        going &= ~done
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
    """The conditions, for a summary."""
    return [
        {"name": c.name, "words": c.words, "courses": list(c.courses), "domain": asdict(c.domain)} for c in CONDITIONS
    ]
