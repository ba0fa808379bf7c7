"""Evaluation of policies in the tasks of the benchmark, and the files of its results.

Episode k of a task has the seed ``FIRST_SEED + k``, whatever is evaluated. A results file is JSON: what was evaluated,
the versions, one row for each episode, and a digest of all that. The results of the baselines are shipped in
``offtrack/environments/results``.
"""

import hashlib
import importlib.metadata
import json
import math
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from importlib import resources
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from controllers.trailer_steering.policy import Network, TrainedFor, load_network, shipped_networks
from offtrack.environments import registry
from offtrack.environments.core import Features
from offtrack.environments.tasks import FIRST_SEED, Task, task_of
from offtrack.environments.training.evaluation import LawPilot, NetworkPilot, driven
from offtrack.environments.training.pilots import DRIVERS, Actions, Pilot
from scenarios.assembly.surrogate import load_surrogate
from scenarios.catalogue import TRAILER_STEERING
from scenarios.extras import check_extra
from scenarios.progress import Progress
from scenarios.results.run_directory import digest, replaced
from vehicle.combination.description import load_vehicle
from vehicle.foundation.user_file import FileKind, read_text
from vehicle.frames import FloatArray

BLOCK: Final = 20  # episodes that are driven together, and kept together
_VERSION: Final = 1  # of the results file
_PACKAGES: Final = ("offtrack", "numpy", "casadi", "gymnasium")
_RESAMPLES: Final = 2000  # of the bootstrap
_Z: Final = 1.959964  # of an interval of 95 %
_SHIPPED: Final = resources.files("offtrack.environments")
_KEYS: Final = ("version", "task", "policy", "policy_sha256", "observation", "first_seed", "versions", "processor_s")


class Episode(NamedTuple):
    """Outcome of an episode."""

    outcome: str
    success: bool
    error_m: float  # as the task defines it
    clearance_m: float | None  # least, from the road's edges; None: the task has none
    effort: float  # RMS rate of the steering demand over its limit [1/s]


class Results(NamedTuple):
    """What was evaluated, and its episodes, from the first seed on."""

    head: Mapping[str, Any]  # by ``_KEYS``
    episodes: tuple[Episode, ...]


class Estimate(NamedTuple):
    """A mean with its interval of 95 %."""

    mean: float
    low: float
    high: float


def networks() -> dict[str, Path]:
    """Networks that were trained for the tasks and are shipped, by name: TASK-ALGORITHM-SEED."""
    folder = Path(str(_SHIPPED / "networks"))
    return {file.stem: file for file in sorted(folder.glob("*.npz"))}


def shipped_results(task: str) -> list[Results]:
    """Results of the baselines of a task."""
    return [read_results(file) for file in sorted(Path(str(_SHIPPED / "results")).glob(f"{task}.*.json"))]


def evaluated(
    name: str, policy: str, episodes: int, former: Results | None, keep: Callable[[Results], None], progress: Progress,
    *, observation: str | None = None,
) -> Results:  # fmt: skip
    """Results of a policy in a task, those of a former evaluation included; every block is given to ``keep``.

    Raises:
        ValueError: one line, if the policy is unknown or does not fit the task.
    """
    done = list(former.episodes if former is not None else ())
    spent = float(former.head["processor_s"]) if former is not None else 0.0
    head = header(name, policy, observation)
    results = Results({**head, "processor_s": spent}, tuple(done))
    while len(done) < episodes:
        progress(len(done), episodes, policy)
        begun = time.process_time()
        done += _block(name, policy, FIRST_SEED + len(done), min(BLOCK, episodes - len(done)), observation)
        spent += time.process_time() - begun
        results = Results({**head, "processor_s": round(spent, 1)}, tuple(done))
        keep(results)
    progress(1, 1, policy)
    return results


def header(name: str, policy: str, observation: str | None) -> dict[str, Any]:
    """What is evaluated, without its time.

    Raises:
        ValueError: one line, if the policy is unknown or does not fit the task.
    """
    task = task_of(name)
    if observation is not None and (task.observation is None or observation not in ("surrogate", "truth", "estimate")):
        choices = "has no choice" if task.observation is None else "must be surrogate, truth or estimate"
        raise ValueError(f"--observation {observation}: of task {name} {choices}")
    with ExitStack() as cleanup:
        _opened(name, policy, 1, observation, cleanup)  # refuses what does not fit
    file = _file(policy)
    return {
        "version": _VERSION,
        "task": name,
        "policy": policy if file is None else file.stem,
        "policy_sha256": None if file is None else digest(file),
        "observation": observation or task.observation,
        "first_seed": FIRST_SEED,
        "versions": {"python": platform.python_version()} | {one: importlib.metadata.version(one) for one in _PACKAGES},
    }


def _block(name: str, policy: str, seed: int, n: int, observation: str | None) -> list[Episode]:
    task = task_of(name)
    with ExitStack() as cleanup:
        env, pilot = _opened(name, policy, n, observation, cleanup)
        watched = _Watched(pilot, env.core.control_rate, task.role)
        ended = driven(env, watched, seed)
        efforts = watched.efforts().tolist()
        return [_episode(task, info, effort) for info, effort in zip(ended, efforts, strict=True)]


def _episode(task: Task, info: Mapping[str, Any], effort: float) -> Episode:
    outcome, clearance = str(info["outcome"]), info.get("edge_clearance_min_m")
    good = task.most is None or float(info[task.most[0]]) <= task.most[1]
    error, clear = round(float(info[task.error]), 4), None if clearance is None else round(float(clearance), 4)
    return Episode(outcome, outcome == "completed" and good, error, clear, round(effort, 4))


class _Watched:
    """A pilot whose steering effort is measured."""

    def __init__(self, pilot: Pilot, rate: float, role: str) -> None:
        self._pilot, self._rate, self._role = pilot, rate, role

    def begin(self, observation: Features) -> None:
        """Begin episodes."""
        self._pilot.begin(observation)
        self._last: FloatArray | None = None
        self._squares, self._steps = np.zeros(len(observation)), np.zeros(len(observation))

    def act(self, observation: Features, going: NDArray[np.bool_]) -> Actions:
        """Actions of the pilot."""
        actions = self._pilot.act(observation, going)
        steer = np.clip(actions.astype(np.float64), -1.0, 1.0)
        if self._role == "driver":
            steer = steer[:, :1]
        elif self._role == "rover":
            steer = 0.5 * (steer[:, 1:] - steer[:, :1])
        rates = self._rate * (steer - (steer if self._last is None else self._last))
        self._squares += going * np.mean(rates**2, axis=1)
        self._steps += going
        self._last = steer
        return actions

    def efforts(self) -> FloatArray:
        """RMS of the rates of each episode (n,) [1/s]."""
        rms: FloatArray = np.sqrt(self._squares / np.maximum(self._steps, 1.0))
        return rms


def _file(policy: str) -> Path | None:
    """File of a network or model; None for a law or a driver."""
    return networks().get(policy) or (Path(policy) if Path(policy).suffix in (".npz", ".zip") else None)


def _opened(name: str, policy: str, n: int, observation: str | None, cleanup: ExitStack) -> tuple[Any, Pilot]:
    """Environment of n episodes, and the pilot."""
    task = task_of(name)
    options = task.environment_options(observation)
    env = registry.vector(task.environment, n, autoreset_mode=AutoresetMode.DISABLED, **options)
    cleanup.callback(env.close)
    file, core = _file(policy), env.core
    if file is not None:
        return env, NetworkPilot(_network(file, core))
    if task.role == "trailer" and (policy in TRAILER_STEERING or ":" in policy):
        vehicle = load_vehicle(str(task.options.get("vehicle", "uk_longer_semitrailer")))
        parameters = {"path": shipped_networks()[0]} if policy == "policy" else {}
        return env, cleanup.enter_context(closing(LawPilot(core, vehicle, policy, load_surrogate(), parameters)))  # type: ignore[arg-type]
    if policy not in task.drivers:
        known = ", ".join((*task.drivers, *(one for one in networks() if one.startswith(f"{name}-"))))
        raise ValueError(f"--policy {policy:.200}: must be one of {known}, or a file .npz or .zip of a network")
    return env, DRIVERS[policy](core)  # type: ignore[arg-type]  # a driver fits the core of its task


def _network(file: Path, core: Any) -> Network:
    features = tuple(feature.name for feature in core.features)
    if file.suffix == ".zip":
        check_extra("rl", "a model of stable-baselines3 needs", "stable_baselines3", "torch")
        from offtrack.environments.training.learner import saved_network

        return saved_network(file, features, core.action_space.shape[0], TrainedFor())
    network = load_network(file)
    if network.features != features or len(network.biases[-1]) != core.action_space.shape[0]:
        raise ValueError(f"policy {file}: its inputs and outputs are not those of this task's environment")
    return network


def write_results(results: Results, path: Path) -> None:
    """Write a results file completely or not at all."""
    content = {**results.head, "columns": Episode._fields, "episodes": results.episodes}
    rows = ",\n".join(json.dumps(episode) for episode in results.episodes)
    text = json.dumps({**content, "sha256": _digest(content), "episodes": []}, indent=1)
    replaced(path, text.replace('"episodes": []', f'"episodes": [\n{rows}\n ]') + "\n")


def read_results(path: Path) -> Results:
    """The results in a file.

    Raises:
        ValueError: one line, if it is no results file, or was changed.
    """
    text = read_text(path, FileKind.RECORD)
    try:
        content = json.loads(text)
        head = {key: content[key] for key in _KEYS}
        episodes = tuple(Episode(*row) for row in content["episodes"])
        if head["version"] != _VERSION or tuple(content["columns"]) != Episode._fields or not episodes:
            raise ValueError("version")
        task_of(head["task"])
        found = _digest({**head, "columns": Episode._fields, "episodes": episodes})
        stated = content["sha256"]
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"{path}: not a results file of offtrack benchmark ({type(error).__name__})") from None
    if stated != found:
        raise ValueError(f"{path}: its sha256 does not fit its contents: it was changed after the evaluation")
    return Results(head, episodes)


def _digest(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def summary(results: Results) -> dict[str, Any]:
    """Means with intervals of 95 %: Wilson's of shares, a bootstrap's of other means."""
    episodes = results.episodes
    clear = [episode.clearance_m for episode in episodes if episode.clearance_m is not None]
    return {
        "policy": results.head["policy"],
        "observation": results.head["observation"],
        "episodes": len(episodes),
        "success": wilson(sum(episode.success for episode in episodes), len(episodes)),
        "error_m": mean([episode.error_m for episode in episodes]),
        "clearance_m": mean(clear) if clear else None,
        "effort": mean([episode.effort for episode in episodes]),
        "rolled_over": wilson(sum(episode.outcome == "rolled over" for episode in episodes), len(episodes)),
        "processor_s": results.head["processor_s"],
    }


def wilson(successes: int, n: int) -> Estimate:
    """Share with Wilson's interval (Wilson 1927)."""
    share, z = successes / n, _Z**2 / n
    half = _Z * math.sqrt(share * (1.0 - share) / n + z / (4.0 * n))
    return Estimate(
        share, max(0.0, (share + 0.5 * z - half) / (1.0 + z)), min(1.0, (share + 0.5 * z + half) / (1.0 + z))
    )


def mean(values: Sequence[float]) -> Estimate:
    """Mean with the interval of a percentile bootstrap."""
    given = np.array(values)
    drawn = np.random.default_rng(1).integers(len(given), size=(_RESAMPLES, len(given)))
    low, high = np.percentile(given[drawn].mean(axis=1), [2.5, 97.5]).tolist()
    return Estimate(float(given.mean()), low, high)
