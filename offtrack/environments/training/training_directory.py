"""Training plan of a policy (task and settings of the learner) and the files of its directory.

The settings were chosen on seeds from 100 on. An action is held for four control steps, 80 ms: the axles respond
within 150 ms, and estimates come every 100 ms, so actions see estimates of every age. The horizon of the discount is
2 s. Rewards fall linearly with the distance from the path, not with its square, so that the last centimetres count.
"""

import importlib.metadata
import json
import platform
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import matplotlib
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from matplotlib.figure import Figure

from controllers.trailer_steering.policy import Network, TrainedFor, save_network
from offtrack.environments import rewards
from offtrack.environments.rewards import Domain, Reward, narrowed
from offtrack.environments.tasks import task_of
from offtrack.reports.plots import ESTIMATED, GREY, INK, SERIES, STYLE, TRUE, WIDTH, legend_below
from offtrack.studies.run_study import check_study_directory, opened_study
from scenarios.assembly.adapters import trailer_geometry
from scenarios.results.log import read_table
from scenarios.results.run_directory import replaced, replacing
from vehicle.combination.description import Vehicle
from vehicle.foundation.user_file import FileKind, read_text
from vehicle.frames import FloatArray

ENVIRONMENT: Final = "TrailerSteering-v0"
ACTION_REPEAT: Final = 4
REWARD: Final[Mapping[Reward, float]] = {rewards.off_path: 1.0, rewards.outside_path: 0.1, rewards.steer_effort: 0.02}
REWARD_SCALE: Final = 0.1  # gives values of the order of 1: half a metre for two seconds is -5
TASK_REWARD: Final = {"off_path": 1.0, "near_edge": 1.0, "steer_effort": 0.02}
Algorithm = Literal["ppo", "sac"]
COURSES: Final = ("roundabout", "roundabout-right", "turn-90", *(f"random-{k}" for k in range(1, 17)))
DEFAULT_DOMAIN: Final = Domain()  # of the environment
DOMAIN: Final = Domain(friction=(0.3, 0.9), speed=(1.4, 5.0))

# Mean and standard deviation of features, by the prefix of their names. They are fixed instead of running statistics:
# left and right stay symmetric, and nearly constant features such as ``usable`` are not amplified.
_NORMALISATION: Final = {
    "off_tracking": (0.0, 0.5),
    "path_direction": (0.0, 0.25),
    "path_turn_": (0.0, 0.5),
    "path_": (0.0, 1.0),
    "hitch_v_x": (3.5, 1.5),
    "hitch_v_y": (0.0, 1.0),
    "trailer_yaw_rate": (0.0, 0.15),
    "goal_ahead": (0.0, 20.0),
    "goal_aside": (0.0, 3.0),
    "goal_direction_cos": (1.0, 0.1),
    "goal_direction_sin": (0.0, 0.25),
    "edge_": (1.5, 1.5),
    "set_speed": (3.5, 1.5),
    "cross_track": (0.0, 0.2),
    "heading_error": (0.0, 0.2),
    "curvature": (0.0, 0.2),
    "slip_angle": (0.0, 0.1),
    "wheel_speed_": (1.0, 0.3),
    "inclination_": (0.0, 0.1),
    "age": (0.14, 0.1),
    "usable": (1.0, 1.0),
    "steer_": (0.0, 0.2),
    "speed": (3.5, 1.5),
    "articulation_": (0.0, 0.3),
    "yaw_rate": (0.0, 0.15),
    "follow_distance": (13.3, 0.8),
}


class Settings(NamedTuple):
    """Settings of proximal policy optimisation, with the names of stable-baselines3."""

    n_steps: int = 32  # actions of every environment between updates: 2.6 s
    batch_size: int = 2048
    n_epochs: int = 10
    gamma: float = 0.96  # per action: a horizon of 2 s
    gae_lambda: float = 0.9
    learning_rate: float = 1e-3  # falls linearly to a tenth
    clip_range: float = 0.2
    target_kl: float = 0.04
    layers: tuple[int, ...] = (64, 64)  # tanh units of both policy and value function


SETTINGS: Final = Settings()
TASK_GAMMA: Final = 0.985  # per action, in tasks with an end to reach: a horizon of 5 s
# Of SAC, with the names of stable-baselines3; an update for every 4 actions of all environments together
SAC_SETTINGS: Final[Mapping[str, Any]] = {
    "learning_rate": 7e-4,
    "buffer_size": 300_000,
    "learning_starts": 5_000,
    "batch_size": 512,
    "train_freq": 1,
    "tau": 0.01,
}
SAC_ACTIONS_PER_UPDATE: Final = 4
LAST_LEARNING_RATE: Final = 0.1  # final over initial learning rate
EXPLORATION: Final = (0.3, 0.05)  # standard deviation of the actions at start and end; scheduled, not learnt


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """Parameters that determine a training, apart from its length."""

    observation: str = "surrogate"
    vehicle: str = "uk_longer_semitrailer"
    envs: int = 512
    seed: int = 1
    task: str | None = None  # of the benchmark; None: steering on many courses, with a reward of its own
    algorithm: Algorithm = "ppo"

    @property
    def name(self) -> str:
        """Name of the environment."""
        return ENVIRONMENT if self.task is None else task_of(self.task).environment

    def environment(self) -> dict[str, Any]:
        """Options of the training environments."""
        if self.task is not None:
            task = task_of(self.task)
            steers = {"reward": TASK_REWARD} if task.role == "trailer" else {}
            repeat = {} if task.role == "rover" else {"action_repeat": ACTION_REPEAT}
            return {**task.environment_options(self.observation, training=True), **steers, **repeat}
        return {
            "observation": self.observation,
            "vehicle": self.vehicle,
            "courses": COURSES,
            "domain": DOMAIN,
            "reward": REWARD,
            "action_repeat": ACTION_REPEAT,
        }

    def domain(self) -> Domain | None:
        """What a trailer's network is trained for; None for other tasks."""
        if self.task is None:
            return DOMAIN
        task = task_of(self.task)
        return narrowed(DEFAULT_DOMAIN, task.options["domain"]) if task.role == "trailer" else None

    def plain(self) -> dict[str, Any]:
        """The plan for JSON, including the fixed settings of this version."""
        if self.task is not None:
            settings = SAC_SETTINGS if self.algorithm == "sac" else {**SETTINGS._asdict(), "gamma": TASK_GAMMA}
            own = {"task": self.task, "algorithm": self.algorithm, "envs": self.envs, "seed": self.seed}
            return {**own, "environment": self.name, "options": self.environment(), self.algorithm: settings}
        return {
            **{name: value for name, value in asdict(self).items() if name not in ("task", "algorithm")},
            "environment": ENVIRONMENT,
            "action_repeat": ACTION_REPEAT,
            "reward": {part.__name__: weight for part, weight in REWARD.items()},
            "courses": list(COURSES),
            "domain": {name: list(limits) for name, limits in asdict(DOMAIN).items()},
            "ppo": {**SETTINGS._asdict(), "layers": list(SETTINGS.layers)},
            "last_learning_rate": LAST_LEARNING_RATE,
            "exploration": list(EXPLORATION),
        }


def normalisation(feature: str) -> tuple[float, float]:
    """Mean and standard deviation that normalise a feature."""
    return next(numbers for start, numbers in _NORMALISATION.items() if feature.startswith(start))


_WINDOW = 15  # points of the moving average
_LEVELS = (ESTIMATED, INK, GREY, *SERIES[2:4])  # colours of the laws


POLICY: Final = "policy"  # key of the trained network among the laws


class Score(NamedTuple):
    """Results of one law in the episodes of one condition."""

    rms_m: float  # of the episodes' off-tracking, root of the mean square
    median_rms_m: float
    max_m: float  # largest off-tracking of all episodes
    outside_max_m: float  # largest distance of the follow point to the outside of a turn, of all episodes
    mishaps: int  # episodes that ended in a mishap


class Point(NamedTuple):
    """State of the training after one update; episode numbers are means over the episodes since the last update."""

    steps: int  # control steps of all environments so far
    wall_s: float  # computing time so far [s]
    episodes: int  # ended since the last update
    rms_m: float  # off-tracking, with exploration noise [m]; NaN: no episode ended
    max_m: float  # the same, maximum [m]
    mishaps: float  # share of the episodes that ended badly
    reward: float  # mean of a control step
    exploration: float  # standard deviation of the actions [-]
    divergence: float  # of the policy from the previous one (Kullback-Leibler)
    explained_variance: float  # by the value function [-]
    success: float  # share of the episodes that were completed


def write_curve(curve: Sequence[Point], path: Path) -> None:
    """Writes the curve; the file appears complete or not at all."""
    table = pa.table({name: [getattr(point, name) for point in curve] for name in Point._fields})
    with replacing(path) as unfinished:
        pq.write_table(table, unfinished)


def read_curve(path: Path) -> list[Point]:
    """The curve in a file of :func:`write_curve`.

    Raises:
        ValueError: one line, if the file cannot be read or has other columns.
    """
    table = read_table(path)
    if tuple(table.column_names) != Point._fields:
        raise ValueError(f"{path}: has {', '.join(table.column_names)}, must have {', '.join(Point._fields)}")
    return [Point(**row) for row in table.to_pylist()]


def draw_curve(curve: Sequence[Point], levels: Mapping[str, float], path: Path) -> None:
    """Draws off-tracking over steps as a PNG, with the off-tracking of trailer laws in the same episodes as lines.

    Without laws, as of a task, it draws the share of completed episodes.
    """
    steps = np.array([point.steps for point in curve]) / 1e6
    rms = np.array([point.rms_m if levels else point.success for point in curve])
    known = np.isfinite(rms)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 3.4), layout="constrained")
        ax = figure.subplots()
        ax.plot(steps[known], rms[known], color=TRUE, linewidth=0.6, alpha=0.4)
        ax.plot(steps[known], _smoothed(rms[known]), color=TRUE, linewidth=2.0, label="policy while exploring")
        for (law, level), colour in zip(levels.items(), _LEVELS, strict=False):
            ax.axhline(level, color=colour, linewidth=1.3, linestyle=(0, (6, 3)), label=law)
        ax.set(xlabel="control steps [millions]", ylabel="share of completed episodes")
        if levels:
            ax.set(yscale="log", ylabel="off-tracking of an episode, RMS [m]")
            ax.yaxis.set_major_formatter("{x:g}")
        legend_below(figure, ax)
        with replacing(path) as unfinished:
            figure.savefig(unfinished, dpi=110, format="png")


def _smoothed(values: FloatArray) -> FloatArray:
    """Moving average."""
    half = _WINDOW // 2
    return np.array([values[max(k - half, 0) : k + half + 1].mean() for k in range(len(values))])


PLAN: Final = "training.json"
NETWORK: Final = "policy.npz"
SUMMARY: Final = "summary.json"
PICTURE: Final = "learning_curve.png"
RESULTS: Final = "benchmark.json"  # of a task
_PACKAGES: Final = ("offtrack", "stable-baselines3", "torch", "gymnasium", "numpy", "casadi")

Scores = Mapping[str, Mapping[str, Score]]  # by condition and law


def check_directory(plan: Plan, directory: Path) -> None:
    """Refuse a directory that contains another training or other files.

    Raises:
        ValueError: one line.
    """
    check_study_directory(directory, PLAN)
    file = directory / PLAN
    if file.is_file() and read_text(file, FileKind.RECORD) != _content(plan):
        raise ValueError(
            f"{file} belongs to a training with other options: choose another --out, or use the same options"
        )


def opened_directory(plan: Plan, directory: Path) -> AbstractContextManager[None]:
    """Lock the directory of a training, which has been checked, and write its plan.

    Raises:
        ValueError: one line, if another process works in it.
    """
    return opened_study(directory, PLAN, _content(plan))


def _content(plan: Plan) -> str:
    return json.dumps(plan.plain(), indent=2) + "\n"


def trained_for(vehicle: Vehicle, domain: Domain = DEFAULT_DOMAIN) -> TrainedFor:
    """What a network for a vehicle's last trailer was trained for in episodes of a domain."""
    trailer = trailer_geometry(vehicle, len(vehicle.units) - 1)
    length, lag = trailer.follow_distance, trailer.actuator_lag
    return TrainedFor(
        speed=domain.speed,
        follow_distance=(length * domain.length[0], length * domain.length[1]),
        actuator_lag=(lag * domain.actuator_lag[0], lag * domain.actuator_lag[1]),
    )


def keep_network(network: Network, path: Path) -> None:
    """Write the network completely or not at all."""
    with replacing(path) as unfinished, unfinished.open("wb") as file:
        save_network(network, file)


def summary(
    plan: Plan, curve: list[Point], scores: Scores, conditions: list[dict[str, Any]], command: str
) -> dict[str, Any]:
    """Summary of the training for JSON; ``conditions`` describe those of the scores."""
    last = curve[-1]
    return {
        "command": command,
        "plan": plan.plain(),
        "versions": {"python": platform.python_version(), **{name: _version(name) for name in _PACKAGES}},
        "steps": last.steps,
        "wall_s": round(last.wall_s, 1),
        "conditions": conditions,
        "scores": {name: {law: score._asdict() for law, score in laws.items()} for name, laws in scores.items()},
    }


def keep_summary(content: Mapping[str, Any], curve: list[Point], scores: Scores, directory: Path) -> None:
    """Write ``summary.json`` and the learning curve, with the laws' results in the training conditions."""
    replaced(directory / SUMMARY, json.dumps(content, indent=2, allow_nan=False) + "\n")
    levels = {law: score.rms_m for law, score in scores["trained"].items() if law != POLICY}
    draw_curve(curve, levels, directory / PICTURE)


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None
