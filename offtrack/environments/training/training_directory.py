"""Training plan of a policy (task and settings of the learner) and the files of its directory.

The settings were chosen on seeds from 100 on. An action is held for four control steps, 80 ms: the axles respond
within 150 ms, and estimates come every 100 ms, so actions see estimates of every age. Rewards fall
linearly with the distance from the path, not with its square, so that the last centimetres count.
"""

import importlib.metadata
import json
import platform
import shlex
import sys
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import matplotlib
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from matplotlib.figure import Figure

from controllers.trailer_steering.policy import Network, TrainedFor, save_network
from offtrack.environments.rewards import DEFAULT_VEHICLE, Domain, narrowed
from offtrack.environments.tasks import task_of
from offtrack.reports.plots import STYLE, TRUE, WIDTH, legend_below
from offtrack.studies.run_study import check_study_directory, opened_study
from scenarios.assembly.adapters import trailer_geometry
from scenarios.results.log import read_table
from scenarios.results.run_directory import replaced, replacing
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.foundation.user_file import FileKind, read_text
from vehicle.frames import FloatArray

ACTION_REPEAT: Final = 4
REWARD: Final = {"off_path": 1.0, "outside_path": 0.1, "near_edge": 1.0, "steer_effort": 0.02}  # of a trailer
REWARD_SCALE: Final = 0.1  # gives values of the order of 1: half a metre for two seconds is -5
Algorithm = Literal["ppo", "sac"]
DEFAULT_DOMAIN: Final = Domain()  # of the environment

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
    gae_lambda: float = 0.9
    learning_rate: float = 1e-3  # falls linearly to a tenth
    clip_range: float = 0.2
    target_kl: float = 0.04
    layers: tuple[int, ...] = (64, 64)  # tanh units of both policy and value function


SETTINGS: Final = Settings()
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """Parameters that determine a training, apart from its length."""

    task: str = "paths"  # of the benchmark
    algorithm: Algorithm = "ppo"
    observation: str = "surrogate"
    vehicle: str | None = None  # None: the task's
    envs: int = 512
    seed: int = 1

    @property
    def name(self) -> str:
        """Name of the environment."""
        return task_of(self.task).environment

    @property
    def discount(self) -> float:
        """Discount of the rewards, per action."""
        return task_of(self.task).discount

    def environment(self) -> dict[str, Any]:
        """Options of the training environments."""
        task = task_of(self.task)
        steers = {"reward": REWARD} if task.role == "trailer" else {}
        repeat = {} if task.role == "rover" else {"action_repeat": ACTION_REPEAT}
        return {**task.environment_options(self.observation, self.vehicle, training=True), **steers, **repeat}

    def domain(self) -> TrainedFor:
        """What a trailer's network is trained for; anything for others."""
        options = self.environment()
        if task_of(self.task).role != "trailer":
            return TrainedFor()
        vehicle = load_vehicle(options.get("vehicle", DEFAULT_VEHICLE))
        return trained_for(vehicle, narrowed(DEFAULT_DOMAIN, options["domain"]))

    def plain(self) -> dict[str, Any]:
        """The plan for JSON, including the fixed settings of this version."""
        own_settings = {"gamma": self.discount, "exploration": task_of(self.task).exploration}
        settings = SAC_SETTINGS if self.algorithm == "sac" else {**SETTINGS._asdict(), **own_settings}
        own = {"task": self.task, "algorithm": self.algorithm, "envs": self.envs, "seed": self.seed}
        return {**own, "environment": self.name, "options": self.environment(), self.algorithm: settings}


def normalisation(feature: str) -> tuple[float, float]:
    """Mean and standard deviation that normalise a feature."""
    return next(numbers for start, numbers in _NORMALISATION.items() if feature.startswith(start))


_WINDOW = 15  # points of the moving average


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


def draw_curve(curve: Sequence[Point], path: Path) -> None:
    """Draws the share of completed episodes over steps as a PNG; for trailers their off-tracking."""
    steps = np.array([point.steps for point in curve]) / 1e6
    rms = np.array([point.rms_m for point in curve])
    trailers = bool(np.isfinite(rms).any())
    values = rms if trailers else np.array([point.success for point in curve])
    known = np.isfinite(values)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 3.4), layout="constrained")
        ax = figure.subplots()
        ax.plot(steps[known], values[known], color=TRUE, linewidth=0.6, alpha=0.4)
        ax.plot(steps[known], _smoothed(values[known]), color=TRUE, linewidth=2.0, label="policy while exploring")
        ax.set(xlabel="control steps [millions]", ylabel="share of completed episodes")
        if trailers:
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
RESULTS: Final = "benchmark.json"
_PACKAGES: Final = ("offtrack", "stable-baselines3", "torch", "gymnasium", "numpy", "casadi")


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


def keep_summary(plan: Plan, curve: list[Point], results: Mapping[str, Any], directory: Path) -> dict[str, Any]:
    """Write ``summary.json``, with these results of the benchmark, and the picture of the curve; return the summary."""
    last = curve[-1]
    content = {
        "command": shlex.join(["offtrack", *sys.argv[1:]]),
        "plan": plan.plain(),
        "versions": {"python": platform.python_version(), **{name: _version(name) for name in _PACKAGES}},
        "steps": last.steps,
        "wall_s": round(last.wall_s, 1),
        **results,
    }
    replaced(directory / SUMMARY, json.dumps(content, indent=2, allow_nan=False) + "\n")
    draw_curve(curve, directory / PICTURE)
    return content


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None
