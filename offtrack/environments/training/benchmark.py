"""Evaluation of policies in the tasks of the benchmark, and the files of its results.

Episode k of a task has the seed ``FIRST_SEED + k``, whatever is evaluated. A results file is JSON: what was evaluated,
the versions, one row for each episode, and a digest of all that. The results of the baselines are shipped in
``offtrack/environments/results/TASK``.
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
from scipy import stats

from controllers.trailer_steering.policy import Network, TrainedFor, load_network, network_file, shipped_networks
from offtrack.environments import registry
from offtrack.environments.rewards import DEFAULT_VEHICLE
from offtrack.environments.tasks import FIRST_SEED, Role, Task, task_of
from offtrack.environments.training.law_pilot import LawPilot
from offtrack.environments.training.pilots import DRIVERS, NetworkPilot, Pilot
from offtrack.studies.table import Exceeding
from scenarios.assembly.surrogate import load_surrogate
from scenarios.catalogue import TRAILER_STEERING
from scenarios.extras import check_extra
from scenarios.progress import Progress
from scenarios.results.run_directory import digest, replaced
from vehicle.combination.description import load_vehicle
from vehicle.foundation.user_file import FileKind, read_text
from vehicle.frames import FloatArray

BLOCK: Final = 50  # episodes that are driven together, and kept together
_RENDERED: Final = 5  # the same, with cameras: each has its own world
_VERSION: Final = 1  # of the results file
_PACKAGES: Final = ("offtrack", "numpy", "casadi", "gymnasium")
_RESAMPLES: Final = 2000  # of the bootstrap
_MEANS: Final = {"success": 1.0, "rolled_over": 1.0, **dict.fromkeys(("error_m", "clearance_m", "effort"), math.inf)}
_SHIPPED: Final = resources.files("offtrack.environments")
_KEYS: Final = ("version", "task", "policy", "policy_sha256", "observation", "first_seed", "versions", "processor_s")


class Episode(NamedTuple):
    """Outcome of an episode."""

    outcome: str
    success: bool
    error_m: float  # as the task defines it
    clearance_m: float | None  # least, from the road's edges; None: the task has none
    effort: float  # RMS rate of the steering demand over its limit [1/s]


class Evaluation(NamedTuple):
    """What is to be evaluated."""

    task: str
    policy: str  # law, driver, shipped network or file
    observation: str | None = None  # None: as in the task
    vehicle: str | None = None  # None: as in the task

    @property
    def file(self) -> Path | None:
        """File of a network or model; None for a law or a driver."""
        if self.policy == "policy":
            return network_file(shipped_networks()[0])
        path = Path(self.policy)
        return networks().get(self.policy) or (path if path.suffix in (".npz", ".zip") else None)


class Results(NamedTuple):
    """What was evaluated, and its episodes, from the first seed on."""

    head: Mapping[str, Any]  # ``_KEYS``, and ``vehicle`` if it is not the task's
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
    return [read_results(file) for file in sorted(Path(str(_SHIPPED / "results" / task)).glob("*.json"))]


def evaluated(
    asked: Evaluation,
    head: Mapping[str, Any],
    episodes: int,
    progress: Progress,
    *,
    former: Results | None = None,
    keep: Callable[[Results], None] = lambda _: None,
) -> Results:
    """Results with this ``header``, those of a former evaluation included; every block is given to ``keep``.

    Raises:
        ValueError: one line, before any block, if the policy is unknown or does not fit the task.
    """
    done = list(former.episodes if former is not None else ())
    spent = float(former.head["processor_s"]) if former is not None else 0.0
    results = Results({**head, "processor_s": spent}, tuple(done))
    block, task, opened = _RENDERED if asked.observation == "estimate" else BLOCK, task_of(asked.task), 0
    with ExitStack() as cleanup:
        while len(done) < episodes:
            progress(len(done), episodes, asked.policy)
            begun, n = time.process_time(), min(block, episodes - len(done))
            if n != opened:
                cleanup.close()
                opened, (env, pilot) = n, _opened(asked, n, cleanup)
            done += [_episode(task, info) for info in driven(env, pilot, FIRST_SEED + len(done), role=task.role)]
            spent += time.process_time() - begun
            results = Results({**head, "processor_s": round(spent, 1)}, tuple(done))
            keep(results)
    progress(1, 1, asked.policy)
    return results


def header(asked: Evaluation) -> dict[str, Any]:
    """What is evaluated, without its time.

    Raises:
        ValueError: one line, if the task has no such observation.
    """
    task, seen = task_of(asked.task), asked.observation
    if seen is not None and (task.observation is None or seen not in ("surrogate", "truth", "estimate")):
        choices = "has no choice" if task.observation is None else "must be surrogate, truth or estimate"
        raise ValueError(f"--observation {seen}: of task {asked.task} {choices}")
    file = asked.file
    return {
        "version": _VERSION,
        "task": asked.task,
        "policy": asked.policy if file is None or asked.policy == "policy" else file.stem,
        "policy_sha256": None if file is None else digest(file),
        "observation": seen or task.observation,
        "first_seed": FIRST_SEED,
        "versions": {"python": platform.python_version()} | {one: importlib.metadata.version(one) for one in _PACKAGES},
        **({} if asked.vehicle is None else {"vehicle": asked.vehicle}),
    }


def _episode(task: Task, info: Mapping[str, Any]) -> Episode:
    outcome, clearance = str(info["outcome"]), info.get("edge_clearance_min_m")
    good = task.most is None or float(info[task.most[0]]) <= task.most[1]
    error, clear = round(float(info[task.error]), 4), None if clearance is None else round(float(clearance), 4)
    return Episode(outcome, outcome == "completed" and good, error, clear, round(float(info["effort"]), 4))


def driven(
    env: Any, pilot: Pilot, seed: int, options: dict[str, Any] | None = None, *, role: Role = "trailer"
) -> list[dict[str, Any]]:
    """Info at the end of one episode of every sub-environment, and ``effort``: RMS rate of the steering demand."""
    observation, _ = env.reset(seed=seed, options=options)
    pilot.begin(observation)
    ended: dict[int, dict[str, Any]] = {}
    active, squares, steps = np.ones(env.num_envs, dtype=bool), np.zeros(env.num_envs), 0
    last: FloatArray | None = None
    while active.any():
        actions = pilot.act(observation, active)
        steer = _STEER[role](np.clip(actions.astype(np.float64), -1.0, 1.0))
        rates = env.core.control_rate * (steer - (steer if last is None else last))
        squares += active * np.mean(rates**2, axis=1)
        steps, last = steps + 1, steer
        observation, _, terminated, truncated, info = env.step(actions)
        done = active & (terminated | truncated)
        for k in np.flatnonzero(done).tolist():
            ended[k] = {name: values[k] for name, values in info.items() if not name.startswith("_")}
            ended[k] |= {"mishap": bool(terminated[k]), "effort": np.sqrt(squares[k] / steps)}
        active &= ~done
    return [ended[k] for k in range(env.num_envs)]


_STEER: Final[Mapping[Role, Callable[[FloatArray], FloatArray]]] = {  # the steering among the actions
    "trailer": lambda actions: actions,
    "driver": lambda actions: actions[:, :1],
    "rover": lambda actions: 0.5 * (actions[:, 1:] - actions[:, :1]),
}


def _opened(asked: Evaluation, n: int, cleanup: ExitStack) -> tuple[Any, Pilot]:
    """Environment of n episodes, and the pilot. A network for a trailer steers as the law ``policy``."""
    task, policy, file = task_of(asked.task), asked.policy, asked.file
    options = task.environment_options(asked.observation, asked.vehicle)
    env = registry.vector(task.environment, n, autoreset_mode=AutoresetMode.DISABLED, **options)
    cleanup.callback(env.close)
    if task.role == "trailer" and (policy in TRAILER_STEERING or ":" in policy or (file and file.suffix == ".npz")):
        law, parameters = (policy, {}) if file is None else ("policy", {"path": str(file)})
        vehicle = load_vehicle(str(options.get("vehicle", DEFAULT_VEHICLE)))
        return env, cleanup.enter_context(closing(LawPilot(env.core, vehicle, law, load_surrogate(), parameters)))  # type: ignore[arg-type]
    if file is not None and policy != "policy":
        return env, NetworkPilot(_network(file, env.core))
    if policy not in task.drivers:
        known = ", ".join((*task.drivers, *(one for one in networks() if one.startswith(f"{asked.task}-"))))
        raise ValueError(f"--policy {policy:.200}: must be one of {known}, or a file .npz or .zip of a network")
    return env, DRIVERS[policy](env.core)  # type: ignore[arg-type]  # a driver fits the core of its task


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
    path.parent.mkdir(parents=True, exist_ok=True)
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
        head = {key: content[key] for key in (*_KEYS, *(["vehicle"] if "vehicle" in content else []))}
        episodes = tuple(Episode(*row) for row in content["episodes"])
        if (head["version"], tuple(content["columns"])) != (_VERSION, Episode._fields) or not episodes:
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
    """Means with intervals of 95 %: Clopper and Pearson's of shares, a bootstrap's of other means."""
    episodes = results.episodes
    clear = [episode.clearance_m for episode in episodes if episode.clearance_m is not None]
    return {
        "policy": results.head["policy"],
        "observation": results.head["observation"],
        "episodes": len(episodes),
        "success": share(sum(episode.success for episode in episodes), len(episodes)),
        "error_m": mean([episode.error_m for episode in episodes]),
        "clearance_m": mean(clear) if clear else None,
        "effort": mean([episode.effort for episode in episodes]),
        "rolled_over": share(sum(episode.outcome == "rolled over" for episode in episodes), len(episodes)),
        "processor_s": results.head["processor_s"],
    }


def of_trainings(summaries: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Means over shipped networks that differ in the seed of the training, with intervals of 95 % (Student's t).

    Each mean is between zero and the limit in ``_MEANS``.
    """
    alike: dict[str, list[Mapping[str, Any]]] = {}
    for one in summaries:
        if one["policy"] in networks():
            alike.setdefault(one["policy"].rpartition("-")[0], []).append(one)
    return [
        {
            **group[0],
            "policy": name,
            "trainings": len(group),
            **{key: _over([one[key].mean for one in group], most) for key, most in _MEANS.items() if group[0][key]},
        }
        for name, group in alike.items()
        if len(group) > 1
    ]


def _over(means: Sequence[float], most: float) -> Estimate:
    middle = float(np.mean(means))
    half = float(stats.t.ppf(0.975, len(means) - 1) * stats.sem(means))
    return Estimate(middle, max(middle - half, 0.0), min(middle + half, most))


def share(number: int, n: int) -> Estimate:
    """Share with its Clopper-Pearson interval."""
    found = Exceeding(number, n)
    return Estimate(found.share, *found.interval())


def mean(values: Sequence[float]) -> Estimate:
    """Mean with the interval of a percentile bootstrap."""
    given = np.array(values)
    drawn = np.random.default_rng(1).integers(len(given), size=(_RESAMPLES, len(given)))
    low, high = np.percentile(given[drawn].mean(axis=1), [2.5, 97.5]).tolist()
    return Estimate(float(given.mean()), low, high)
