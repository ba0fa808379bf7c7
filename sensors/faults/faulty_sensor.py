"""Sensors with faults: they have the same ``sample(truth)`` as the sound sensor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

import numpy as np

from sensors.faults.fault import Fault, FaultContext, Pinhole
from sensors.sensor import Message, Sensor, Stamped, message_type

TruthT = TypeVar("TruthT", bound=Stamped)
MessageT = TypeVar("MessageT", bound=Message)


def with_faults(
    sensor: Sensor[TruthT, MessageT],
    faults: Sequence[Fault],
    *,
    camera: Pinhole | None,
    unit: int,
    rng: Callable[[int], np.random.Generator],
    message: type[MessageT] | None = None,
) -> Sensor[TruthT, MessageT]:
    """The sensor with all faults, the first of them closest to it; the sensor itself if there are none.

    Args:
        sensor: the sound one.
        faults: in the order in which they act.
        camera: intrinsics of the images; None if it sends none.
        unit: of the vehicle that carries the sensor: 0 for the tractor or a rover.
        rng: random stream of the fault of this number.
        message: class of the sensor's messages; None: the one that its ``sample`` is annotated with.

    Raises:
        ValueError: one line, if a fault does not apply to such a sensor.
    """
    if not faults:
        return sensor
    message = message or message_type(sensor)
    for k, fault in enumerate(faults):
        context = FaultContext(message=message, camera=camera, unit=unit, rng=rng(k))
        sensor = FaultySensor(sensor, fault, context, message)
    return sensor


class FaultySensor(Generic[TruthT, MessageT]):
    """A sensor with one fault."""

    def __init__(
        self, sensor: Sensor[TruthT, MessageT], fault: Fault, context: FaultContext, message: type[MessageT]
    ) -> None:
        self._sensor, self._fault, self._message = sensor, fault, message
        self._kind = fault.built(context)

    def sample(self, truth: TruthT) -> MessageT | None:
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
