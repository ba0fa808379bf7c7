"""Network of a model that stable-baselines3 saved: weights of its actor as plain arrays.

A saved model is a zip archive. Only tensors (``policy.pth``) and JSON (``data``) are read; the pickled objects in it,
which could run any code, are left alone. Needs the extra ``rl``.
"""

from __future__ import annotations

import io
import json
import re
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import torch

from controllers.trailer_steering.policy import Network, feature_names
from vehicle.combination.description import Vehicle
from vehicle.foundation.data_file import read_archive, unpacked
from vehicle.foundation.user_file import FileKind, shown
from vehicle.frames import FloatArray


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


def saved_network(path: Path, vehicle: Vehicle) -> Network:
    """The mean action of a saved model (PPO, A2C, SAC, TD3, DDPG with ``MlpPolicy``) for a vehicle's last trailer.

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
        _features(path, vehicle, len(mean)),
        _activation(path, arguments, actor),
        "tanh" if arguments.get("squash_output") is True else actor.output,
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


def _features(path: Path, vehicle: Vehicle, count: int) -> tuple[str, ...]:
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
