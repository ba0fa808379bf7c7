"""A trained policy as a steering law: a small network of plain arrays, without a learning framework.

The network was trained in the environment ``TrailerSteering`` and receives the same inputs as there: the newest
estimate, constant until the next one, and the combination's own sensors. A ``.npz`` file contains

    W0, b0, W1, b1 ...   weights (n_out, n_in) and biases (n_out,), layer by layer
    mean, scale          (n_features,) subtracted from every feature, and divisor of the difference
    features             (n_features,) their names, in order
    functions            (2,) between the layers: tanh or relu; of the output: clip or tanh. Not given: tanh and clip
    domain               (3, 2) least and largest speed [m/s], follow distance [m] and lag of the actuators [s] of the
                         training. Not given: that of the environment, for any trailer

The output, within -1 .. 1, is the demanded angle over the actuators' limit. Outside its domain the network does not
steer: there path preview does.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.trailer import Actuation, Combination, SpeedRange, SteerCommand, SteeringLaw, TrailerGeometry
from controllers.trailer_steering.kinematics import check_steered
from controllers.trailer_steering.path_laws import PathLawMemory, PathPreview
from estimators.estimates import Health, OffTracking
from estimators.off_tracking.hitch_path import crossing
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.foundation.data_file import read_arrays
from vehicle.foundation.user_file import FileType, shown
from vehicle.frames import FloatArray, arc_length
from vehicle.option import PartParameters, option

NETWORK_FILE: Final = FileType("a trained network", 16_000_000)
_SHIPPED: Final = resources.files("controllers.trailer_steering") / "networks"
_ROUNDING: Final = 1e-6  # of limits in files [m, s]
_LARGEST: Final = 1e9  # number of a network: its outputs cannot overflow then
_HIDDEN: Final[dict[str, Callable[[FloatArray], FloatArray]]] = {
    "tanh": np.tanh,
    "relu": lambda values: np.maximum(values, 0.0),
}
_OUTPUT: Final[dict[str, Callable[[FloatArray], FloatArray]]] = {
    "clip": lambda values: np.clip(values, -1.0, 1.0),
    "tanh": np.tanh,
}
AHEAD = (0.25, 0.5, 0.75)  # of the follow distance: points on the path from the follow point to the hitch


class TrainedFor(NamedTuple):
    """Domain of a training, each from the least to the largest."""

    speed: tuple[float, float] = (0.0, 5.6)  # [m/s]; default: of the environment, 20 km/h
    follow_distance: tuple[float, float] = (0.0, math.inf)  # [m]
    actuator_lag: tuple[float, float] = (0.0, math.inf)  # [s]

    def lacks(self, trailer: TrailerGeometry) -> str | None:
        """What the training was for, where a trailer is outside of it, in words; None if it is within."""
        for words, value, unit, trained in (
            ("follow distance", trailer.follow_distance, "m", self.follow_distance),
            ("lag of the actuators", trailer.actuator_lag, "s", self.actuator_lag),
        ):
            if not _within(value, trained):
                return f"a {words} of {trained[0]:.3g} to {trained[1]:.3g} {unit}, not of {value:.3g} {unit}"
        return None


def _within(value: float, limits: tuple[float, float]) -> bool:
    return limits[0] - _ROUNDING <= value <= limits[1] + _ROUNDING


class Network(NamedTuple):
    """A multilayer perceptron, the scaling of its inputs, and what it was trained for."""

    weights: tuple[FloatArray, ...]
    biases: tuple[FloatArray, ...]
    mean: FloatArray
    scale: FloatArray
    features: tuple[str, ...]
    hidden: str = "tanh"  # function between the layers: tanh or relu
    output: str = "clip"  # function of the output: clip to -1 .. 1, or tanh
    trained_for: TrainedFor = TrainedFor()

    def __call__(self, features: FloatArray) -> FloatArray:
        """The action, within -1 .. 1, for features (n_features,), or the actions for rows of them."""
        values = (features - self.mean) / self.scale
        for weights, biases in zip(self.weights[:-1], self.biases[:-1], strict=True):
            values = _HIDDEN[self.hidden](values @ weights.T + biases)
        return _OUTPUT[self.output](values @ self.weights[-1].T + self.biases[-1])


def shipped_networks() -> tuple[str, ...]:
    """Names of the networks of the package; a ``.json`` file of the same name has the training parameters."""
    return tuple(sorted(file.name.removesuffix(".npz") for file in _SHIPPED.iterdir() if file.name.endswith(".npz")))


def network_file(name: str) -> Path:
    """The file of a shipped network, or else the file of that path."""
    return Path(str(_SHIPPED / f"{name}.npz")) if name in shipped_networks() else Path(name)


def load_network(path: Path) -> Network:
    """The network of a file.

    Raises:
        ValueError: one line, if there is none, or its arrays do not fit together.
    """
    if path.suffix.lower() == ".zip":
        raise ValueError(f"policy {path}: convert a model of stable-baselines3 first: offtrack convert-policy {path}")
    try:
        arrays = read_arrays(path, NETWORK_FILE)
    except ValueError as error:
        raise ValueError(f"policy {error}") from error
    n = sum(name.startswith("W") for name in arrays)
    needed = ["mean", "scale", "features", *(f"{kind}{k}" for k in range(max(n, 1)) for kind in "Wb")]
    missing = [name for name in needed if name not in arrays]
    if missing:
        raise ValueError(f"policy {path}: has no {', '.join(missing)}")
    for name in needed:
        expected = "U" if name == "features" else "biuf"
        if arrays[name].dtype.kind not in expected or (arrays[name].ndim != 1 and not name.startswith("W")):
            raise ValueError(f"policy {path}: {name} must be a row of {'words' if expected == 'U' else 'numbers'}")
    network = Network(
        tuple(arrays[f"W{k}"].astype(np.float64) for k in range(n)),
        tuple(arrays[f"b{k}"].astype(np.float64) for k in range(n)),
        arrays["mean"].astype(np.float64),
        arrays["scale"].astype(np.float64),
        tuple(str(name) for name in arrays["features"]),
        *_functions(path, arrays),
        _trained_for(path, arrays),
    )
    _check(network, path)
    return network


def save_network(network: Network, path: Path | BinaryIO) -> None:
    """Write a file for ``load_network``."""
    layers = {f"W{k}": weights for k, weights in enumerate(network.weights)}
    layers |= {f"b{k}": biases for k, biases in enumerate(network.biases)}
    words = {"features": np.array(network.features), "domain": np.array(network.trained_for)}
    if (network.hidden, network.output) != ("tanh", "clip"):
        words["functions"] = np.array([network.hidden, network.output])
    np.savez(path, mean=network.mean, scale=network.scale, **words, **layers)  # type: ignore[arg-type]  # its stubs take the layers for allow_pickle


class PolicyMemory(NamedTuple):
    """State of the law between two steps."""

    estimate: tuple[float, ...] | None  # features of the newest usable one; None before the first
    estimate_tick: int  # its capture
    demand: tuple[float, ...]  # last command [rad]
    preview: PathLawMemory  # of path preview, which measures the lag of the actuators


class Policy(SteeringLaw[PolicyMemory]):
    """Angles from a trained network, for the speeds and combinations of its training; else path preview steers.

    So it does while the measured lag of the actuators is outside of the training's.
    """

    beyond_reach = True  # as in the training: so the network makes up for the lag; held back, the loop swings

    class Parameters(PartParameters):
        """The network."""

        path: str = option("file of the network, or the name of a shipped one")

    def __init__(self, trailer: TrailerGeometry, *, combination: Combination, parameters: Parameters) -> None:
        """A controller for the trailer of a ``combination``.

        Raises:
            ValueError: one line, if the trailer has no steered axle, or the file has no network for a trailer.
        """
        check_steered("policy", trailer)
        self._trailer, self._network = trailer, load_network(network_file(parameters.path))
        names = feature_names(len(trailer.steered_distances), [unit.name for unit in combination.vehicle.units])
        if "off_tracking" not in self._network.features:
            raise ValueError(f"policy {parameters.path}: reads no off_tracking, so it is not for a trailer")
        same, outputs = self._network.features == names, len(self._network.biases[-1])
        if same and outputs != len(trailer.steered_distances):
            raise ValueError(f"policy {parameters.path}: steers {outputs} axles")
        trained_for = self._network.trained_for
        self.outside = trained_for.lacks(trailer) if same else self._other_than(combination.vehicle.name, set(names))
        fastest = -1.0 if self.outside else trained_for.speed[1]
        self.speeds = SpeedRange(fastest, fastest + max(1.0, 0.2 * fastest))
        self.above = self._preview = PathPreview(trailer)

    def _other_than(self, vehicle: str, names: set[str]) -> str:
        """That the network was trained for another combination, given the features of this one, in words."""
        own = set(self._network.features)
        differences = [
            f"{words} {shown(', '.join(sorted(left)))}"
            for words, left in (("reads", own - names), ("does not read", names - own))
            if left
        ]
        return f"another combination than {vehicle}: its network {' and '.join(differences) or 'has another order'}"

    def init(self) -> PolicyMemory:
        """Memory without any estimate, wheels straight."""
        return PolicyMemory(None, 0, self._trailer.straight, self._preview.init())

    def actuated(self, memory: PolicyMemory, actuation: Actuation) -> PolicyMemory:
        """Memory with the state of the actuators."""
        return memory._replace(preview=self._preview.actuated(memory.preview, actuation))

    def step(
        self, memory: PolicyMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[PolicyMemory, SteerCommand]:
        """New memory and command at ``tick``; wheels stay straight before the path is known."""
        length = self._trailer.follow_distance
        usable = off_tracking is not None and off_tracking.health is not Health.LOST
        if off_tracking is not None and usable:
            memory = memory._replace(estimate=estimate_features(off_tracking, length), estimate_tick=off_tracking.tick)
        preview, command = self._preview.step(memory.preview, tick, off_tracking, signals)
        lag = preview.answers.lag(self._trailer)
        if self.outside or not _within(lag, self._network.trained_for.actuator_lag):
            return memory._replace(demand=preview.demand, preview=preview), command
        demand = np.array(memory.demand)
        if memory.estimate is not None:
            age = (tick - memory.estimate_tick) * TICK
            features = np.array([*memory.estimate, age, float(usable), *signal_features(signals, length)])
            demand = self._trailer.max_steer * self._network(features)
        steered = tuple(demand.tolist())
        preview = preview._replace(demand=steered, bias=0.0)  # it must not adapt while the network steers
        return memory._replace(demand=steered, preview=preview), SteerCommand(angles=demand)


def estimate_features(estimate: OffTracking, follow_distance: float) -> tuple[float, ...]:
    """Features of a good estimate: ``feature_names`` up to ``trailer_yaw_rate``."""
    s = arc_length(estimate.path)
    passed = crossing(estimate.path, s, -follow_distance)
    back = s[-1] if passed is None else passed.s
    ahead = np.interp(back - follow_distance * np.array(AHEAD), s, estimate.path[:, 1])
    return (estimate.value, estimate.path_tangent, *ahead.tolist(), estimate.v_x, estimate.v_y, estimate.yaw_rate)


def signal_features(signals: CombinationSignals, follow_distance: float) -> tuple[float, ...]:
    """Features from the combination's own sensors: ``feature_names`` from ``steer_trailer_1`` on."""
    steering = (*signals.angles.tolist(), signals.steer, signals.speed)
    turning = (*signals.articulation.tolist(), *signals.yaw_rates.tolist())
    return (*steering, *turning, follow_distance)


def feature_names(n_steered: int, units: Sequence[str]) -> tuple[str, ...]:
    """Names of the features of a network for such a trailer, in order."""
    return (
        "off_tracking",
        "path_direction",
        *(f"path_{share:g}_ahead" for share in AHEAD),
        "hitch_v_x",
        "hitch_v_y",
        "trailer_yaw_rate",
        "age",
        "usable",
        *(f"steer_trailer_{k + 1}" for k in range(n_steered)),
        "steer_tractor",
        "speed",
        *(f"articulation_{k + 1}" for k in range(len(units) - 1)),
        *(f"yaw_rate_{name}" for name in units),
        "follow_distance",
    )


def _trained_for(path: Path, arrays: Mapping[str, NDArray[Any]]) -> TrainedFor:
    """Domain of the training."""
    if "domain" not in arrays:
        return TrainedFor()
    limits = arrays["domain"]
    if limits.dtype.kind not in "biuf" or limits.shape != (3, 2) or not np.all(limits[:, 0] <= limits[:, 1]):
        raise ValueError(f"policy {path}: domain must be three rows of a least and a largest number")
    return TrainedFor(*((float(low), float(high)) for low, high in limits))


def _functions(path: Path, arrays: Mapping[str, NDArray[Any]]) -> tuple[str, str]:
    """Functions between the layers and of the output."""
    if "functions" not in arrays:
        return "tanh", "clip"
    hidden, output, *more = (*(str(name) for name in np.ravel(arrays["functions"])[:3]), "", "")
    if hidden not in _HIDDEN or output not in _OUTPUT or any(more):
        raise ValueError(
            f"policy {path}: functions must be one of {', '.join(_HIDDEN)} and one of {', '.join(_OUTPUT)}"
        )
    return hidden, output


def _check(network: Network, path: Path) -> None:
    """Refuse layers that do not fit together, and numbers that are not finite."""
    size = len(network.features)
    if network.mean.shape != (size,) or network.scale.shape != (size,) or not np.all(network.scale > 1.0 / _LARGEST):
        raise ValueError(f"policy {path}: mean and scale must be of {size} numbers, scale above {1.0 / _LARGEST:g}")
    for k, (weights, biases) in enumerate(zip(network.weights, network.biases, strict=True)):
        if weights.ndim != 2 or weights.shape != (len(biases), size):
            raise ValueError(f"policy {path}: W{k} of shape {weights.shape} must be ({len(biases)}, {size})")
        size = len(biases)
    numbers = (*network.weights, *network.biases, network.mean, network.scale)
    if not all(np.all(np.abs(array) <= _LARGEST) for array in numbers):
        raise ValueError(f"policy {path}: has numbers that are not finite, or above {_LARGEST:g}")
