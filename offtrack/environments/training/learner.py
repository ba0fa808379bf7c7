"""Proximal policy optimisation with stable-baselines3, and networks as arrays of models that it trained or saved.

An interrupted training resumes from its last checkpoint, with new episodes. A saved model is a zip archive. Only its
tensors (``policy.pth``) and JSON (``data``) are read; the pickled objects in it, which could run any code, are left
alone. Needs the extra ``rl``.
"""

import io
import json
import math
import os
import re
import time
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from controllers.trailer_steering.policy import Network, TrainedFor
from offtrack.environments.sb3 import Sb3VecEnv, sb3_vector
from offtrack.environments.tasks import task_of
from offtrack.environments.training.training_directory import (
    LAST_LEARNING_RATE,
    REWARD_SCALE,
    SAC_ACTIONS_PER_UPDATE,
    SAC_SETTINGS,
    SETTINGS,
    Plan,
    Point,
    normalisation,
    read_curve,
    write_curve,
)
from scenarios.progress import Progress
from scenarios.results.run_directory import replacing
from vehicle.foundation.data_file import read_archive, unpacked
from vehicle.foundation.user_file import FileKind, shown
from vehicle.frames import FloatArray

CHECKPOINT: Final = "checkpoint.zip"
CURVE: Final = "learning_curve.parquet"
_NOT_SAVED: Final = ("learning_rate", "lr_schedule")  # of a model: functions that belong to the callback
_COUNTERS: Final = ("num_timesteps", "_n_updates")
_BETWEEN_CHECKPOINTS: Final = 15.0  # [s]
_SAC_INTERVAL: Final = 50_000  # control steps between two points of the curve
_NO_MISHAP: Final = ("completed", "timed out", "")


class Budget(NamedTuple):
    """End of a training: a number of steps or a duration, whichever comes first."""

    steps: int  # control steps of all environments together
    seconds: float | None


class Scaled(BaseFeaturesExtractor):  # type: ignore[misc]  # untyped: the extra may not be installed
    """Features normalised by fixed means and standard deviations."""

    def __init__(self, space: spaces.Box[np.float32], mean: list[float], scale: list[float]) -> None:
        """Mean and standard deviation for each feature of a space."""
        super().__init__(space, len(mean))
        self.register_buffer("mean", torch.tensor(mean))
        self.register_buffer("scale", torch.tensor(scale))

    def forward(self, features: Any) -> Any:
        """Normalise a batch of features."""
        return (features - self.mean) / self.scale


def learn(plan: Plan, budget: Budget, directory: Path, progress: Progress) -> tuple[Network, list[Point]]:
    """Train to the end of the budget, from the directory's checkpoint if there is one; return network and curve.

    Raises:
        ValueError: one line, if an option does not fit, or if the checkpoint belongs to another training.
        KeyboardInterrupt: the checkpoint is kept.
    """
    env = sb3_vector(plan.name, plan.envs, reward_scale=REWARD_SCALE, **plan.environment())
    try:
        recorder = _Recorder(plan, budget, directory, progress)
        model = _model(plan, env, directory, recorder)
        left = budget.steps // recorder.repeat - model.num_timesteps
        if left > 0 and recorder.share < 1.0:
            model.set_random_seed(plan.seed + model.num_timesteps)  # a checkpoint has no states of random generators
            model.learn(left, callback=recorder, reset_num_timesteps=False)
            recorder.keep(model)
        state = {name: _array(tensor) for name, tensor in model.policy.state_dict().items()}
        names = tuple(feature.name for feature in _features(env))
        return _assembled(directory / CHECKPOINT, state, {}, names, plan.domain(), "tanh"), recorder.curve
    finally:
        env.close()


def _model(plan: Plan, env: Sb3VecEnv, directory: Path, recorder: "_Recorder") -> Any:
    """Model with the state of the checkpoint, if there is one."""
    s = SETTINGS
    mean, scale = zip(*(normalisation(feature.name) for feature in _features(env)), strict=True)
    scaled = {
        "activation_fn": torch.nn.Tanh,
        "features_extractor_class": Scaled,
        "features_extractor_kwargs": {"mean": list(mean), "scale": list(scale)},
    }
    common: dict[str, Any] = {"seed": plan.seed, "device": "cpu", "gamma": plan.discount}
    if plan.algorithm == "sac":
        updates = max(1, plan.envs // SAC_ACTIONS_PER_UPDATE)
        arguments = {"net_arch": list(s.layers), **scaled}
        model: Any = SAC("MlpPolicy", env, gradient_steps=updates, policy_kwargs=arguments, **SAC_SETTINGS, **common)
    else:
        model = PPO(
            "MlpPolicy",
            env,
            learning_rate=recorder.learning_rate,
            n_steps=s.n_steps,
            batch_size=min(s.batch_size, s.n_steps * plan.envs),
            n_epochs=s.n_epochs,
            gae_lambda=s.gae_lambda,
            clip_range=s.clip_range,
            target_kl=s.target_kl,
            policy_kwargs={"net_arch": {"pi": list(s.layers), "vf": list(s.layers)}, **scaled},
            **common,
        )
    model.set_logger(Logger(folder=None, output_formats=[]))  # the usual one makes a temporary directory for each model
    if os.path.lexists(directory / CHECKPOINT):
        _resume(model, directory / CHECKPOINT)
        steps = model.num_timesteps * recorder.repeat
        recorder.curve = [point for point in read_curve(directory / CURVE) if point.steps <= steps]
    return model


def _resume(model: Any, file: Path) -> None:
    """Take weights, optimiser and counters from a checkpoint.

    Only tensors and numbers are read: ``PPO.load`` would also unpickle objects, which can run any code.
    """
    members = read_archive(file, FileKind.CHECKPOINT)
    try:
        names = model._get_torch_save_params()[0]
        model.set_parameters({name: _tensors(members[f"{name}.pth"]) for name in names}, device="cpu")
        numbers = json.loads(members["data"])
        for name in _COUNTERS:
            setattr(model, name, int(numbers[name]))
    except Exception as error:  # torch and json raise almost anything for a damaged file
        reason = shown(str(error).partition("\n")[0])
        raise ValueError(f"{file}: training can not be resumed ({reason}); choose another --out") from error


def _tensors(content: bytes) -> Any:
    unpacked(content, "a member", FileKind.CHECKPOINT)  # it is an archive itself, whose size is checked here
    return torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)


class _Recorder(BaseCallback):  # type: ignore[misc]  # likewise
    """Callback that records time, learning curve and checkpoints."""

    def __init__(self, plan: Plan, budget: Budget, directory: Path, progress: Progress) -> None:
        super().__init__()
        self.repeat: int = plan.environment().get("action_repeat", 1)
        self._interval = _SAC_INTERVAL if plan.algorithm == "sac" else 1
        self.curve: list[Point] = []
        self._exploration = task_of(plan.task).exploration
        self._budget, self._directory, self._progress = budget, directory, progress
        self._ended: list[dict[str, Any]] = []
        self._rewards: list[float] = []
        self._since: float | None = None  # start of learning in this process [s]
        self._kept = time.monotonic()

    @property
    def share(self) -> float:
        """Share of the budget that is spent."""
        steps = self.curve[-1].steps if self.curve else 0
        spent = steps / self._budget.steps
        return spent if self._budget.seconds is None else max(spent, self._seconds() / self._budget.seconds)

    def learning_rate(self, _: float) -> float:
        """Learning rate, which falls with the share of the budget."""
        return SETTINGS.learning_rate * (1.0 - (1.0 - LAST_LEARNING_RATE) * min(self.share, 1.0))

    def keep(self, model: Any) -> None:
        """Write the curve, which may be ahead, then the checkpoint, each completely or not at all."""
        write_curve(self.curve, self._directory / CURVE)
        with replacing(self._directory / CHECKPOINT) as unfinished, unfinished.open("wb") as file:
            model.save(file, exclude=_NOT_SAVED)
        self._kept = time.monotonic()

    def _on_training_start(self) -> None:
        self._before = self.curve[-1].wall_s if self.curve else 0.0
        self._since = time.monotonic()

    def _on_step(self) -> bool:
        self._ended += [info for info in self.locals["infos"] if info]
        self._rewards.append(float(np.mean(self.locals["rewards"])))
        return self._budget.seconds is None or self._seconds() < self._budget.seconds

    def _on_rollout_start(self) -> None:
        if hasattr(self.model.policy, "log_std"):
            first, last = (math.log(deviation) for deviation in self._exploration)  # scheduled, of the actions
            log_std = self.model.policy.log_std.requires_grad_(False)
            log_std.fill_(first + (last - first) * min(self.share, 1.0))
        self._record(self._interval)
        if time.monotonic() - self._kept > _BETWEEN_CHECKPOINTS:
            self.keep(self.model)

    def _on_training_end(self) -> None:
        self._record(1)

    def _record(self, least: int) -> None:
        """Add a point to the curve if there were at least this number of steps since the last one."""
        if self._steps() - (self.curve[-1].steps if self.curve else 0) < least:
            return
        self.curve.append(self._point())
        self._ended, self._rewards = [], []
        newest = self.curve[-1]
        explored = f", {newest.rms_m:.3f} m RMS while exploring" if math.isfinite(newest.rms_m) else ""
        explored += f", {100.0 * newest.success:.0f} % completed" if math.isfinite(newest.success) else ""
        self._progress(min(self.share, 1.0), 1.0, f"{newest.steps / 1e6:.1f} M steps{explored}")

    def _steps(self) -> int:
        return int(self.model.num_timesteps) * self.repeat

    def _seconds(self) -> float:
        before = self.curve[-1].wall_s if self.curve else 0.0
        return before if self._since is None else self._before + time.monotonic() - self._since

    def _point(self) -> Point:
        logged, policy = self.model.logger.name_to_value, self.model.policy
        ended = self._ended or [{}]
        nan = float("nan")
        return Point(
            steps=self._steps(),
            wall_s=self._seconds(),
            episodes=len(self._ended),
            rms_m=float(np.mean([one.get("true_rms_m", nan) for one in ended])),
            max_m=float(np.mean([one.get("true_max_m", nan) for one in ended])),
            mishaps=float(np.mean([one.get("outcome", "") not in _NO_MISHAP for one in ended])),
            reward=float(np.mean(self._rewards or [nan])) / REWARD_SCALE / self.repeat,
            exploration=float(torch.exp(policy.log_std).mean()) if hasattr(policy, "log_std") else nan,
            divergence=float(logged.get("train/approx_kl", nan)),
            explained_variance=float(logged.get("train/explained_variance", nan)),
            success=float(np.mean([one["outcome"] == "completed" for one in self._ended])) if self._ended else nan,
        )


def _features(env: Sb3VecEnv) -> Any:
    return env.env.core.features  # type: ignore[attr-defined]  # this environment's core has them


def _array(tensor: Any) -> Any:
    return np.asarray(tensor.detach().numpy(), dtype=np.float64)


class _Actor(NamedTuple):
    """Where the weights of an algorithm's actor are, and its functions."""

    algorithms: str
    hidden: str  # key of a hidden layer's weights, up to its number
    last: str | None  # key of the last layer; None: the last of ``hidden``
    activation: str  # by default
    output: str


_ACTORS: Final = (
    _Actor("PPO or A2C", "mlp_extractor.policy_net", "action_net", "tanh", "clip"),
    _Actor("SAC", "actor.latent_pi", "actor.mu", "relu", "tanh"),
    _Actor("TD3 or DDPG", "actor.mu", None, "relu", "tanh"),
)
_ACTIVATIONS: Final = {"Tanh": "tanh", "ReLU": "relu"}
_EXTRACTOR: Final = re.compile(r"(?:actor\.|pi_)?features_extractor\.(.+)")


def saved_network(path: Path, features: tuple[str, ...], actions: int, domain: TrainedFor) -> Network:
    """The mean action of a saved model (PPO, A2C, SAC, TD3, DDPG with ``MlpPolicy``) of an environment.

    The file does not say what the model was trained for: ``domain`` does.

    Raises:
        ValueError: one line, if the file is no such model, or has other inputs or outputs than the environment.
    """
    members = read_archive(path, FileKind.CHECKPOINT)
    for name in ("data", "policy.pth"):
        if name not in members:
            raise ValueError(f"{path}: not a model saved by stable-baselines3: it holds no '{name}'")
    data, state = _json(path, members["data"]), _state(path, members["policy.pth"])
    arguments = data.get("policy_kwargs")
    network = _assembled(path, state, arguments if isinstance(arguments, dict) else {}, features, domain)
    if len(network.biases[-1]) != actions:
        raise ValueError(
            f"{path}: has {len(network.biases[-1])} actions, the environment {actions}: choose the --vehicle, or the "
            "task, that it was trained with"
        )
    return network


def _assembled(
    path: Path,
    state: dict[str, FloatArray],
    arguments: dict[str, Any],
    features: tuple[str, ...],
    domain: TrainedFor,
    activation: str | None = None,
) -> Network:
    """Network from the tensors of a policy and the arguments that it was made with."""
    actor = next((kind for kind in _ACTORS if f"{kind.hidden}.0.weight" in state), None)
    if actor is None or (actor.last is not None and f"{actor.last}.weight" not in state):
        raise ValueError(
            f"{path}: must be a PPO, A2C, SAC, TD3 or DDPG model with an MlpPolicy of one hidden layer or more"
        )
    names = _layers(actor, state)
    mean, scale = _scaling(path, state, state[f"{names[0]}.weight"].shape[1])
    if len(features) != len(mean):
        raise ValueError(
            f"{path}: has {len(mean)} inputs, the environment gives {len(features)}: choose the --vehicle, or the "
            "task, that it was trained with; wrapped observations cannot be converted"
        )
    return Network(
        tuple(state[f"{name}.weight"] for name in names),
        tuple(state[f"{name}.bias"] for name in names),
        mean,
        scale,
        features,
        activation or _activation(path, arguments, actor),
        "tanh" if arguments.get("squash_output") is True else actor.output,
        domain,
    )


def _json(path: Path, content: bytes) -> dict[str, Any]:
    try:
        data = json.loads(content)
    except (ValueError, RecursionError):
        data = None
    if not isinstance(data, dict):
        raise ValueError(f"{path}: its 'data' is not a JSON object")
    return data


def _state(path: Path, content: bytes) -> dict[str, FloatArray]:
    """Tensors by name."""
    try:
        tensors = _tensors(content)
        return {str(name): np.asarray(tensor.detach().numpy(), dtype=np.float64) for name, tensor in tensors.items()}
    except Exception as error:  # of any class, for a damaged file
        raise ValueError(f"{path}: policy.pth cannot be read: {shown(str(error).partition(chr(10))[0], 120)}") from None


def _layers(actor: _Actor, state: dict[str, FloatArray]) -> list[str]:
    """Names of the actor's layers, in order."""
    pattern = re.compile(re.escape(actor.hidden) + r"\.(\d+)\.weight")
    numbers = sorted(int(found[1]) for found in map(pattern.fullmatch, state) if found)
    return [f"{actor.hidden}.{k}" for k in numbers] + ([actor.last] if actor.last else [])


def _scaling(path: Path, state: dict[str, FloatArray], count: int) -> tuple[FloatArray, FloatArray]:
    """Mean and divisor of the inputs, of a features extractor like the one of `offtrack train`, or 0 and 1."""
    parts = {found[1]: state[found[0]] for found in map(_EXTRACTOR.fullmatch, state) if found}
    if not parts:
        return np.zeros(count), np.ones(count)
    if set(parts) != {"mean", "scale"}:
        raise ValueError(
            f"{path}: has a features extractor with '{shown(min(parts), 40)}': only an MlpPolicy can be converted"
        )
    return parts["mean"], parts["scale"]


def _activation(path: Path, arguments: dict[str, Any], actor: _Actor) -> str:
    """Function of the hidden layers."""
    stated = arguments.get("activation_fn")
    if stated is None:
        return actor.activation
    found = re.search(r"\.(\w+)'>$", str(stated))
    name = found[1] if found else str(stated)
    if name not in _ACTIVATIONS:
        raise ValueError(f"{path}: activation_fn = {shown(name, 40)}: must be one of {', '.join(_ACTIVATIONS)}")
    return _ACTIVATIONS[name]
