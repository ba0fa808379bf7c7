"""Faults as plain data, the protocol of a fault kind, the names of the kinds, and sensors with faults.

``FAULTS`` lists the kinds. A kind of one's own is a class with the members of ``FaultKind``; the base
classes in ``message_kinds`` and ``image_kinds`` define most of them.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Final, Generic, Protocol, TypeAlias, TypeVar

import numpy as np

from sensors.camera.rig import CameraModel, StereoCalibration
from sensors.messages import Message, Sensor, Stamped, message_type
from vehicle.clock import to_ticks
from vehicle.option import Option

T = TypeVar("T", bound=Stamped)
Options: TypeAlias = tuple[Option, ...]
Pinhole: TypeAlias = StereoCalibration | CameraModel
"""Size and intrinsics of images."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultContext:
    """Properties of the faulty sensor, handed to a fault kind's constructor."""

    message: type[Message]  # class of its messages
    camera: Pinhole | None  # of its images; None: it sends none
    unit: int  # that carries it: 0 for the tractor or a rover
    rng: np.random.Generator  # of this fault alone


class FaultKind(Protocol):
    """One kind of fault. The first line of the class's docstring is its description in listings."""

    options: ClassVar[Options]  # numbers that set its severity, in this order
    needs: ClassVar[str]  # sensors it applies to, as errors name them, e.g. "a stereo camera"

    def __init__(self, amount: tuple[float, ...], context: FaultContext) -> None:
        """A fault of this severity: one number for each of ``options``."""

    @classmethod
    def applies_to(cls, message: type[Message]) -> bool:
        """Test whether sensors of such messages can have this fault."""

    def sample(self, sensor: Sensor[T, Message], truth: T, active: bool) -> Message | None:
        """Message of the faulty sensor, or None if none arrives.

        It is called at every capture, also while the fault is not active. Then it returns the sound sensor's message.
        """


class Graded(Protocol):
    """A fault kind of sensors or of the rest of the loop, as far as its severity goes."""

    options: ClassVar[Options]  # numbers that set it, in this order


KindT = TypeVar("KindT", bound=Graded)


@dataclass(frozen=True, slots=True, kw_only=True)
class TimedFault(Generic[KindT]):
    """A fault of given kind, severity and time.

    Raises:
        ValueError: one line naming what is out of range.
    """

    name: str  # of the kind, for errors
    kind: type[KindT]
    amount: tuple[float, ...] = ()  # one number for each of the kind's ``options``; empty: their defaults
    start: float = 0.0  # [s]
    duration: float | None = None  # [s]; None: to the end of the run

    def __post_init__(self) -> None:
        options = self.kind.options
        if len(self.amount) not in (0, len(options)):
            needed = ", ".join(f"{option.name} [{option.unit}]" for option in options) or "no number"
            raise ValueError(f"{self.name}: amount = {list(self.amount)} must be {needed}")
        for option, value in zip(options, self.amount, strict=False):
            whole = option.kind is int and value.is_integer()
            option.check(int(value) if whole else value, f"{self.name}: {option.name}")
        if self.start < 0.0 or (self.duration is not None and self.duration <= 0.0):
            raise ValueError(f"{self.name}: start = {self.start} s and duration = {self.duration} s must be positive")

    def active(self, tick: int) -> bool:
        """Test whether the fault is active at a tick."""
        begin = to_ticks(self.start, f"{self.name}: start")
        end = math.inf if self.duration is None else begin + to_ticks(self.duration, f"{self.name}: duration")
        return begin <= tick < end


class Fault(TimedFault[FaultKind]):
    """A fault of a sensor."""

    __slots__ = ()

    def built(self, context: FaultContext) -> FaultKind:
        """The fault kind's object for one sensor.

        Raises:
            ValueError: one line, if sensors of such messages cannot have this fault.
        """
        if not self.kind.applies_to(context.message):
            raise ValueError(
                f"faults: {self.name} needs {self.kind.needs}; the sensor of this run sends {context.message.__name__}"
            )
        return self.kind(self.amount or defaults(self.kind), context)


def defaults(kind: type[Graded]) -> tuple[float, ...]:
    """Default amounts of a fault kind.

    Raises:
        ValueError: if one of its amounts has no default number.
    """
    values = [option.default for option in kind.options]
    numbers = [float(value) for value in values if isinstance(value, int | float)]
    if len(numbers) < len(values):
        raise ValueError(f"{kind.__name__}: every amount needs a number as its default")
    return tuple(numbers)


MessageT = TypeVar("MessageT", bound=Message)


def with_faults(
    sensor: Sensor[T, MessageT],
    faults: Sequence[Fault],
    *,
    camera: Pinhole | None,
    unit: int,
    rng: Callable[[int], np.random.Generator],
) -> Sensor[T, MessageT]:
    """The sensor with all faults, the first of them closest to it; the sensor itself if there are none.

    Args:
        sensor: the sound one.
        faults: in the order in which they act.
        camera: intrinsics of the images; None if it sends none.
        unit: of the vehicle that carries the sensor: 0 for the tractor or a rover.
        rng: random stream of the fault of this number.

    Raises:
        ValueError: one line, if a fault does not apply to such a sensor.
    """
    if not faults:
        return sensor
    message = message_type(sensor)
    for k, fault in enumerate(faults):
        context = FaultContext(message=message, camera=camera, unit=unit, rng=rng(k))
        sensor = _FaultySensor(sensor, fault, context, message)
    return sensor


class _FaultySensor(Generic[T, MessageT]):
    """A sensor with one fault."""

    def __init__(
        self, sensor: Sensor[T, MessageT], fault: Fault, context: FaultContext, message: type[MessageT]
    ) -> None:
        self._sensor, self._fault, self._message = sensor, fault, message
        self._kind = fault.built(context)

    def sample(self, truth: T) -> MessageT | None:
        """The message that arrives at this tick.

        Raises:
            ValueError: if the fault kind returns a message of another class.
        """
        message = self._kind.sample(self._sensor, truth, self._fault.active(truth.tick))
        if message is None or isinstance(message, self._message):
            return message
        raise ValueError(
            f"faults: {self._fault.name} returned {type(message).__name__} instead of {self._message.__name__}"
        )


FAULTS: Final = {
    "dropout": "sensors.faults.message_kinds:Dropout",
    "duplicate": "sensors.faults.message_kinds:Duplicate",
    "freeze": "sensors.faults.message_kinds:Freeze",
    "delay": "sensors.faults.message_kinds:Delay",
    "desync": "sensors.faults.image_kinds:Desync",
    "decalibration": "sensors.faults.image_kinds:Decalibration",
    "dirt": "sensors.faults.image_kinds:Dirt",
    "glare": "sensors.faults.image_kinds:Glare",
    "gain": "sensors.faults.image_kinds:Gain",
    "blackout": "sensors.faults.image_kinds:Blackout",
    "articulation_offset": "sensors.faults.message_kinds:ArticulationOffset",
    "articulation_stuck": "sensors.faults.message_kinds:ArticulationStuck",
    "gyro_bias": "sensors.faults.message_kinds:GyroBias",
    "gyro_drift": "sensors.faults.message_kinds:GyroDrift",
    "wheel_speed_dropout": "sensors.faults.message_kinds:WheelSpeedDropout",
}


def checked_kind(name: str, part: object) -> type[FaultKind]:
    """The part, if it is a fault kind.

    Raises:
        ValueError: one line naming the members that are missing.
    """
    missing = [member for member in _MEMBERS if not hasattr(part, member)]
    if missing or not isinstance(part, type):
        raise ValueError(f"{name} is no fault kind: {', '.join(missing) or 'it is no class'} missing")
    return part


_MEMBERS: Final = ("options", "needs", "applies_to", "sample")
