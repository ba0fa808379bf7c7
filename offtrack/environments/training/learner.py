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
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from controllers.trailer_steering.policy import Network, TrainedFor, feature_names
from offtrack.environments.sb3 import Sb3VecEnv, sb3_vector
from offtrack.environments.training.training_directory import (
    ACTION_REPEAT,
    DOMAIN,
    ENVIRONMENT,
    EXPLORATION,
    LAST_LEARNING_RATE,
    REWARD_SCALE,
    SETTINGS,
    Plan,
    Point,
    normalisation,
    read_curve,
    trained_for,
    write_curve,
)
from scenarios.progress import Progress
from scenarios.results.run_directory import replacing
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.foundation.data_file import read_archive, unpacked
from vehicle.foundation.user_file import FileKind, shown
from vehicle.frames import FloatArray

CHECKPOINT: Final = "checkpoint.zip"
CURVE: Final = "learning_curve.parquet"
_NOT_SAVED: Final = ("learning_rate", "lr_schedule")  # of a model: functions that belong to the callback
_STATES: Final = ("policy", "policy.optimizer")  # of a checkpoint: what training changes, with the counters
_COUNTERS: Final = ("num_timesteps", "_n_updates")
_BETWEEN_CHECKPOINTS: Final = 15.0  # [s]


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
    env = sb3_vector(ENVIRONMENT, plan.envs, reward_scale=REWARD_SCALE, **plan.environment())
    try:
        recorder = _Recorder(budget, directory, progress)
        model = _model(plan, env, directory, recorder)
        left = budget.steps // ACTION_REPEAT - model.num_timesteps
        if left > 0 and recorder.share < 1.0:
            model.set_random_seed(plan.seed + model.num_timesteps)  # a checkpoint has no states of random generators
            model.learn(left, callback=recorder, reset_num_timesteps=False)
            recorder.keep(model)
        network = _network(model, [feature.name for feature in _features(env)])
        return network._replace(trained_for=trained_for(load_vehicle(plan.vehicle), DOMAIN)), recorder.curve
    finally:
        env.close()


def _model(plan: Plan, env: Sb3VecEnv, directory: Path, recorder: "_Recorder") -> Any:
    """Model with the state of the checkpoint, if there is one."""
    s = SETTINGS
    mean, scale = zip(*(normalisation(feature.name) for feature in _features(env)), strict=True)
    model = PPO(
        "MlpPolicy",
        env,
        learning_rate=recorder.learning_rate,
        n_steps=s.n_steps,
        batch_size=min(s.batch_size, s.n_steps * plan.envs),
        n_epochs=s.n_epochs,
        gamma=s.gamma,
        gae_lambda=s.gae_lambda,
        clip_range=s.clip_range,
        target_kl=s.target_kl,
        policy_kwargs={
            "net_arch": {"pi": list(s.layers), "vf": list(s.layers)},
            "activation_fn": torch.nn.Tanh,
            "features_extractor_class": Scaled,
            "features_extractor_kwargs": {"mean": list(mean), "scale": list(scale)},
        },
        seed=plan.seed,
        device="cpu",
    )
    if os.path.lexists(directory / CHECKPOINT):
        _resume(model, directory / CHECKPOINT)
        recorder.curve = [point for point in read_curve(directory / CURVE) if point.steps <= _steps(model)]
    return model


def _resume(model: Any, file: Path) -> None:
    """Take weights, optimiser and counters from a checkpoint.

    Only tensors and numbers are read: ``PPO.load`` would also unpickle objects, which can run any code.
    """
    members = read_archive(file, FileKind.CHECKPOINT)
    try:
        model.set_parameters({name: _tensors(members[f"{name}.pth"]) for name in _STATES}, device="cpu")
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

    def __init__(self, budget: Budget, directory: Path, progress: Progress) -> None:
        super().__init__()
        self.curve: list[Point] = []
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
        first, last = (math.log(deviation) for deviation in EXPLORATION)  # scheduled, of the actions
        log_std = self.model.policy.log_std.requires_grad_(False)
        log_std.fill_(first + (last - first) * min(self.share, 1.0))
        self._record()
        if time.monotonic() - self._kept > _BETWEEN_CHECKPOINTS:
            self.keep(self.model)

    def _on_training_end(self) -> None:
        self._record()

    def _record(self) -> None:
        """Add a point to the curve if there were steps since the last one."""
        if _steps(self.model) <= (self.curve[-1].steps if self.curve else 0):
            return
        self.curve.append(self._point())
        self._ended, self._rewards = [], []
        newest = self.curve[-1]
        explored = f", {newest.rms_m:.3f} m RMS while exploring" if math.isfinite(newest.rms_m) else ""
        self._progress(min(self.share, 1.0), 1.0, f"{newest.steps / 1e6:.1f} M steps{explored}")

    def _seconds(self) -> float:
        before = self.curve[-1].wall_s if self.curve else 0.0
        return before if self._since is None else self._before + time.monotonic() - self._since

    def _point(self) -> Point:
        logged = self.model.logger.name_to_value
        ended = self._ended or [{}]
        nan = float("nan")
        return Point(
            steps=_steps(self.model),
            wall_s=self._seconds(),
            episodes=len(self._ended),
            rms_m=float(np.mean([one.get("true_rms_m", nan) for one in ended])),
            max_m=float(np.mean([one.get("true_max_m", nan) for one in ended])),
            mishaps=float(np.mean([not one.get("TimeLimit.truncated", True) for one in ended])),
            reward=float(np.mean(self._rewards or [nan])) / REWARD_SCALE / ACTION_REPEAT,
            exploration=float(torch.exp(self.model.policy.log_std).mean()),
            divergence=float(logged.get("train/approx_kl", nan)),
            explained_variance=float(logged.get("train/explained_variance", nan)),
        )


def _steps(model: Any) -> int:
    return int(model.num_timesteps) * ACTION_REPEAT


def _features(env: Sb3VecEnv) -> Any:
    return env.env.core.features  # type: ignore[attr-defined]  # this environment's core has them


def _network(model: Any, features: list[str]) -> Network:
    """Network that gives a model's mean action."""
    policy = model.policy
    linear = [layer for layer in policy.mlp_extractor.policy_net if isinstance(layer, torch.nn.Linear)]
    layers = [*linear, policy.action_net]
    return Network(
        tuple(_array(layer.weight) for layer in layers),
        tuple(_array(layer.bias) for layer in layers),
        _array(policy.features_extractor.mean),
        _array(policy.features_extractor.scale),
        tuple(features),
    )


def _array(tensor: Any) -> Any:
    return tensor.detach().numpy()


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


def saved_network(path: Path, vehicle: Vehicle, domain: TrainedFor) -> Network:
    """The mean action of a saved model (PPO, A2C, SAC, TD3, DDPG with ``MlpPolicy``) for a vehicle's last trailer.

    The file does not say what the model was trained for: ``domain`` does.

    Raises:
        ValueError: one line, if the file is no such model, or has other inputs than ``TrailerSteering-v0`` gives.
    """
    members = read_archive(path, FileKind.CHECKPOINT)
    for name in ("data", "policy.pth"):
        if name not in members:
            raise ValueError(f"{path}: not a model saved by stable-baselines3: it holds no '{name}'")
    data, state = _json(path, members["data"]), _state(path, members["policy.pth"])
    actor = next((kind for kind in _ACTORS if f"{kind.hidden}.0.weight" in state), None)
    if actor is None or (actor.last is not None and f"{actor.last}.weight" not in state):
        raise ValueError(
            f"{path}: must be a PPO, A2C, SAC, TD3 or DDPG model with an MlpPolicy of one hidden layer or more"
        )
    names = _layers(actor, state)
    arguments = data.get("policy_kwargs")
    arguments = arguments if isinstance(arguments, dict) else {}
    mean, scale = _scaling(path, state, state[f"{names[0]}.weight"].shape[1])
    network = Network(
        tuple(state[f"{name}.weight"] for name in names),
        tuple(state[f"{name}.bias"] for name in names),
        mean,
        scale,
        _input_names(path, vehicle, len(mean)),
        _activation(path, arguments, actor),
        "tanh" if arguments.get("squash_output") is True else actor.output,
        domain,
    )
    steered = len(vehicle.units[-1].steered_axles)
    if len(network.biases[-1]) != steered:
        raise ValueError(
            f"{path}: has {len(network.biases[-1])} actions, the last trailer {steered} steered axles: choose "
            "the --vehicle that it was trained with"
        )
    return network


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
    unpacked(content, f"{path}: policy.pth", FileKind.CHECKPOINT)  # an archive itself, whose size is checked here
    try:
        tensors = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
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


def _input_names(path: Path, vehicle: Vehicle, count: int) -> tuple[str, ...]:
    """Names of the inputs."""
    names = feature_names(len(vehicle.units[-1].steered_axles), [unit.name for unit in vehicle.units])
    if len(names) != count:
        raise ValueError(
            f"{path}: has {count} inputs, offtrack/TrailerSteering-v0 gives {len(names)} for this vehicle: choose the "
            "--vehicle that it was trained with; wrapped observations cannot be converted"
        )
    return names


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
