"""Comparison of a network with steering laws, all in the same episodes outside the training.

A law gets the observed estimate and signals, and the hitch path at the time of the estimate: the true path plus the
estimate's error, which grows linearly from hitch to follow point as in the surrogate.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import asdict, replace
from types import MappingProxyType
from typing import Any, Final, NamedTuple, cast

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from controllers.trailer import Combination, TrailerSteering
from controllers.trailer_steering.policy import Network, feature_names
from estimators.estimates import Health, OffTracking
from estimators.off_tracking.hitch_path import crossing, tangent
from offtrack.environments import registry
from offtrack.environments.core import Features
from offtrack.environments.observations import Mark
from offtrack.environments.rewards import Domain
from offtrack.environments.trailer_steering import TrailerSteering as TrailerSteeringCore
from offtrack.environments.training.pilots import Pilot
from offtrack.environments.training.training_directory import COURSES, DOMAIN, ENVIRONMENT, POLICY, Plan, Score
from scenarios.assembly.adapters import trailer_geometry
from scenarios.assembly.drivers_and_laws import trailer_law
from scenarios.assembly.surrogate import SurrogateParameters, load_surrogate
from scenarios.progress import Progress
from sensors.messages import CombinationSignals
from vehicle.clock import TICK, to_ticks
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.foundation.own_parts import close_part
from vehicle.frames import FloatArray, arc_length
from vehicle.option import Parameter

_KEPT: Final = 60  # control steps: age of the oldest usable estimate
_FITTED: Final = 1.0  # of path behind the hitch, to fit its direction [m]
_BEYOND: Final = 1.5  # of path behind the follow point, for the fits around it [m]


class _Lane(NamedTuple):
    """Law of one episode."""

    law: TrailerSteering[Any]
    memory: Any
    follow_distance: float
    estimate: OffTracking | None


class LawPilot:
    """Pilot that steers all episodes of a core by laws of one name."""

    def __init__(
        self,
        core: TrailerSteeringCore,
        vehicle: Vehicle,
        law: str,
        errors: SurrogateParameters,
        parameters: Mapping[str, Parameter] = MappingProxyType({}),
    ) -> None:
        """``errors`` give the standard deviation of the estimates, ``parameters`` are the law's.

        Raises:
            ValueError: one line, if the law is unknown, or cannot steer this vehicle.
        """
        self._core, self._vehicle, self._law, self._parameters = core, vehicle, law, parameters
        self._std = float(np.sqrt(errors.bias**2 + errors.drift**2 + errors.noise**2))
        self._geometry = trailer_geometry(vehicle, len(vehicle.units) - 1)
        n_steered = len(self._geometry.steered_distances)
        names = feature_names(n_steered, [unit.name for unit in vehicle.units])
        self._column = {name: k for k, name in enumerate(names)}
        self._axles = [names.index(f"steer_trailer_{k + 1}") for k in range(n_steered)]
        self._articulation = [k for k, name in enumerate(names) if name.startswith("articulation_")]
        self._yaw_rates = [k for k, name in enumerate(names) if name.startswith("yaw_rate_")]
        self._period = to_ticks(1.0 / core.control_rate, "control period")
        self._marks: deque[tuple[int, Mark]] = deque(maxlen=_KEPT)
        self._tick = 0
        self._lanes: list[_Lane] = []

    def begin(self, observation: NDArray[np.float32]) -> None:
        """Begin episodes in all lanes, with their first observation (n, n_features)."""
        self.close()
        self._tick = 0
        self._marks.clear()
        self._lanes = [self._opened(float(row[self._column["follow_distance"]])) for row in observation]

    def act(self, observation: NDArray[np.float32], going: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Actions (n, n_steered) for an observation, once per control step; 0 for episodes that are over."""
        self._marks.append((self._tick, self._core.hitch_paths.mark()))
        actions = np.zeros((len(observation), len(self._axles)), dtype=np.float32)
        for k in np.flatnonzero(going).tolist():
            row = observation[k].astype(np.float64)
            lane = self._updated(k, row)
            memory, command = lane.law.step(lane.memory, self._tick, lane.estimate, self._signals(row))
            self._lanes[k] = lane._replace(memory=memory)
            actions[k] = command.angles / self._geometry.max_steer
        self._tick += self._period
        return actions

    def close(self) -> None:
        """Close the laws of all episodes."""
        for lane in self._lanes:
            close_part(lane.law)
        self._lanes = []

    def _opened(self, follow_distance: float) -> _Lane:
        longer = follow_distance - self._geometry.follow_distance  # the axles have moved with the trailer's end
        distances = tuple(distance + longer for distance in self._geometry.axle_distances)
        geometry = replace(self._geometry, follow_distance=follow_distance, axle_distances=distances)
        combination = Combination(self._vehicle, len(self._vehicle.units) - 1)
        law = trailer_law(self._law, geometry, combination, self._parameters)
        return _Lane(law, law.init(), follow_distance, None)

    def _updated(self, k: int, row: FloatArray) -> _Lane:
        """The lane with the estimate of an observation's row, if that is a new one."""
        lane = self._lanes[k]
        usable = row[self._column["usable"]] > 0.5
        tick = self._tick - round(float(row[self._column["age"]]) / TICK)
        known = lane.estimate
        if known is not None and tick <= known.tick:
            if not usable and known.health is not Health.LOST:
                lane = lane._replace(estimate=replace(known, health=Health.LOST, std=np.inf))
            return lane
        mark = next((mark for at, mark in self._marks if at >= tick), None)
        if mark is None:
            return lane
        return lane._replace(estimate=self._estimate(k, row, tick, mark, lane.follow_distance))

    def _estimate(self, k: int, row: FloatArray, tick: int, mark: Mark, follow: float) -> OffTracking:
        at = self._column
        path = self._core.hitch_paths.behind(k, mark, follow + _BEYOND)
        s = arc_length(path)
        passed = crossing(path, s, -follow)
        value = float(row[at["off_tracking"]])
        if passed is not None:
            path = path + np.column_stack([np.zeros(len(s)), (value - passed.y) * s / passed.s])
        v_x, v_y, yaw_rate = (float(row[at[name]]) for name in ("hitch_v_x", "hitch_v_y", "trailer_yaw_rate"))
        at_hitch = tangent(path, s, 0.0, _FITTED)
        return OffTracking(
            tick=tick,
            value=value,
            std=self._std,
            health=Health.OK,
            path=path,
            hitch_direction=at_hitch.direction,
            hitch_direction_rate=at_hitch.curvature * float(np.hypot(v_x, v_y)) - yaw_rate,
            path_tangent=float(row[at["path_direction"]]),
            v_x=v_x,
            v_y=v_y,
            yaw_rate=yaw_rate,
        )

    def _signals(self, row: FloatArray) -> CombinationSignals:
        at = self._column
        speed, turning = float(row[at["speed"]]), float(row[self._yaw_rates[-1]])
        return CombinationSignals(
            tick=self._tick,
            angles=row[self._axles],
            speed=speed,
            steer=float(row[at["steer_tractor"]]),
            articulation=row[self._articulation],
            yaw_rates=row[self._yaw_rates],
            lateral_acceleration=speed * turning,  # steady turn: the observation has no accelerometer
        )


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
        core = cast(TrailerSteeringCore, env.core)
        pilot: Pilot = NetworkPilot(network)
        if law != POLICY:
            pilot = cleanup.enter_context(closing(LawPilot(core, load_vehicle(plan.vehicle), law, load_surrogate())))
        return _score(driven(env, pilot, _SEED + plan.seed))


def driven(env: Any, pilot: Pilot, seed: int, options: dict[str, Any] | None = None) -> list[dict[str, Any]]:
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
