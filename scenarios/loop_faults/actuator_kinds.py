"""Fault kinds of a trailer's steering actuators.

The plant's actuators follow a demand with a lag and limits. A fault changes the demand so that they move as faulty ones
do, in every plant. Axles that one actuator turns share its fault.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import ClassVar, Final

import numpy as np

from scenarios.loop_faults.fault import ActuatorFault, LoopFaultContext
from vehicle.clock import TICK
from vehicle.combination.unit import Unit
from vehicle.frames import FloatArray
from vehicle.option import Option

_AXLE: Final = Option("axle", 0, "steered axle of the trailer from the front; 0: all", low=0, high=20)


class _OnAxles(ActuatorFault):
    """Base of the kinds below: picks the faulty axles, and knows when the fault began. Its last number is the axle."""

    def __init__(self, amount: tuple[float, ...], context: LoopFaultContext) -> None:
        super().__init__(amount, context)
        self._axles = _faulty_axles(context.trailer, int(amount[-1]))  # (n_steered,)
        self._held: FloatArray | None = None  # last demand on the faulty actuators [rad]; None: the fault is not active
        self._tick = 0  # of that demand

    def demanded(self, tick: int, demand: FloatArray, angles: FloatArray, active: bool) -> FloatArray:
        """Demand for the faulty axles, and the given one for the others."""
        if not active:
            self._held = None
            return demand
        held = angles if self._held is None else self._held
        elapsed = 0.0 if self._held is None else (tick - self._tick) * TICK
        self._held, self._tick = self.moved(held, demand, elapsed), tick
        return np.where(self._axles, self._held, demand)

    @abstractmethod
    def moved(self, held: FloatArray, demand: FloatArray, elapsed: float) -> FloatArray:
        """Demand (n_steered,) [rad] on faulty actuators, from the last one, ``elapsed`` [s] before.

        At the beginning of the fault the last one is the angle of each axle.
        """


class ActuatorStuck(_OnAxles):
    """The trailer's steered axles stay at their angles.

    Steered tag axles of trucks do so after faults of their valves: "fixed in current position" (Scania, fault code
    ESTA 0254).
    """

    options: ClassVar[tuple[Option, ...]] = (_AXLE,)

    def moved(self, held: FloatArray, demand: FloatArray, elapsed: float) -> FloatArray:
        """The angles at the beginning."""
        return held


class ActuatorSlow(_OnAxles):
    """The trailer's steered axles turn at a share of their highest rate."""

    options: ClassVar[tuple[Option, ...]] = (
        Option("share", 0.2, "rate limit over that of sound actuators", low=0.001, high=1.0),
        _AXLE,
    )

    def __init__(self, amount: tuple[float, ...], context: LoopFaultContext) -> None:
        super().__init__(amount, context)
        trailer = context.trailer
        limit = trailer.steering.rate_limit if trailer.steering else 0.0
        self._rates = amount[0] * limit * np.array([abs(axle.steer_ratio) for axle in trailer.steered_axles])  # [rad/s]

    def moved(self, held: FloatArray, demand: FloatArray, elapsed: float) -> FloatArray:
        """The demand, as far as the axles come."""
        return _towards(demand, held, self._rates * elapsed)


class ActuatorOffset(_OnAxles):
    """The trailer's steered axles stand beside their demand."""

    options: ClassVar[tuple[Option, ...]] = (
        Option("offset", 2.0, "added to the demand, + left", unit="deg", low=-45.0, high=45.0),
        _AXLE,
    )

    def moved(self, held: FloatArray, demand: FloatArray, elapsed: float) -> FloatArray:
        """The demand with the offset."""
        return demand + math.radians(self._amount[0])


class ActuatorDead(_OnAxles):
    """The trailer's steered axles have no power: they centre themselves and stay straight.

    Steered tag axles of trucks do so after a fault of their supply: "centered due to a fault" (Scania, fault code
    EST 0239). The rate at which the centring cylinders turn them is assumed.
    """

    options: ClassVar[tuple[Option, ...]] = (
        Option("rate", 5.0, "at which the axles return to straight", unit="deg/s", low=0.1, high=90.0),
        _AXLE,
    )

    def moved(self, held: FloatArray, demand: FloatArray, elapsed: float) -> FloatArray:
        """Straight, as far as the axles come."""
        return _towards(np.zeros_like(held), held, np.full(len(held), math.radians(self._amount[0]) * elapsed))


def _towards(target: FloatArray, held: FloatArray, steps: FloatArray) -> FloatArray:
    """The held angles, moved towards the target by the ``steps`` (n,) [rad] at most."""
    moved: FloatArray = held + np.clip(target - held, -steps, steps)
    return moved


def _faulty_axles(trailer: Unit, axle: int) -> FloatArray:
    """Mask (n_steered,) of the steered axles that one fault concerns.

    Raises:
        ValueError: one line, if there is no such axle.
    """
    steered = [k for k, one in enumerate(trailer.axles) if one.steered]
    if axle > len(steered):
        axles = "1 steered axle" if len(steered) == 1 else f"{len(steered)} steered axles"
        raise ValueError(f"axle = {axle}: {trailer.name} has {axles}")
    faulty = {
        k for actuator in trailer.actuators if axle == 0 or steered[axle - 1] in actuator.axles for k in actuator.axles
    }
    return np.array([k in faulty for k in steered])
