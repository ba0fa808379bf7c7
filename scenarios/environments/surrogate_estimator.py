"""Surrogate estimator as a scenario's ``off_tracking``: the errors of the fast environments in a run.

Comparing such a run with a camera run shows the effect of the cameras on a policy trained with the surrogate.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar, NamedTuple, Self

import numpy as np

from estimators.context import TrailerContext
from estimators.estimates import Health, OffTracking
from estimators.off_tracking.reference import ReferenceMemory, ReferenceOffTracking
from scenarios.environments.surrogate import SurrogateParameters, drifted, load_surrogate
from sensors.messages import BodyPose
from vehicle.clock import TICK
from vehicle.frames import FloatArray
from vehicle.option import Option

_FRAMES = 4096  # of random numbers: several minutes; a longer run repeats them


class SurrogateMemory(NamedTuple):
    """Memory between poses."""

    reference: ReferenceMemory
    frames: int  # so far
    drift: float  # [m]
    lost: bool


class SurrogateOffTracking:
    """Off-tracking from exact poses, with the errors and losses of ``surrogate.SurrogateParameters`` on it."""

    sensor: ClassVar[str] = "reference_pose"
    options: ClassVar[tuple[Option, ...]] = ()

    def __init__(
        self, follow_distance: float, rng: np.random.Generator, parameters: SurrogateParameters | None = None
    ) -> None:
        """For a follow point ``follow_distance`` [m] behind the hitch; by default with the shipped parameters.

        Raises:
            ValueError: if ``follow_distance`` is not positive.
        """
        self._parameters = load_surrogate() if parameters is None else parameters
        self._exact = ReferenceOffTracking(follow_distance)
        self._follow_distance = follow_distance
        self._bias, self._first_drift = rng.standard_normal(2) * [self._parameters.bias, self._parameters.drift]
        self._normal = rng.standard_normal((_FRAMES, 5))
        self._chance = rng.random(_FRAMES)

    @classmethod
    def of(cls, context: TrailerContext) -> Self:
        """Estimator for the context's trailer, with errors from its random stream."""
        return cls(context.follow_distance, context.rng)

    def init(self) -> SurrogateMemory:
        """Memory before the first pose."""
        return SurrogateMemory(self._exact.init(), 0, float(self._first_drift), False)

    def step(self, memory: SurrogateMemory, pose: BodyPose) -> tuple[SurrogateMemory, OffTracking | None]:
        """Memory with the pose in it, and the off-tracking at its tick; None for the first pose."""
        before = memory.reference.previous
        reference, exact = self._exact.step(memory.reference, pose)
        if before is None or exact is None:
            return memory._replace(reference=reference), exact
        p, k = self._parameters, memory.frames % _FRAMES
        interval = (pose.tick - before.tick) * TICK
        drift = float(drifted(p, interval, memory.drift, self._normal[k, 0]))
        chance = interval / p.loss_duration if memory.lost else interval * p.loss_rate
        lost = memory.lost ^ bool(self._chance[k] < chance)
        after = SurrogateMemory(reference, memory.frames + 1, drift, lost)
        if exact.health is Health.LOST:
            return after, exact
        if lost:
            return after, replace(exact, value=0.0, std=math.inf, health=Health.LOST)
        error = float(self._bias) + drift + p.noise * float(self._normal[k, 1])
        return after, self._with_error(exact, error, self._normal[k, 2:])

    def _with_error(self, exact: OffTracking, error: float, normal: FloatArray) -> OffTracking:
        """The estimate with an error that grows linearly from 0 at the hitch to ``error`` at the follow point [m]."""
        p = self._parameters
        back = exact.path[:, 0] / -self._follow_distance
        v_x, v_y = p.velocity_noise * normal[:2]
        return replace(
            exact,
            value=exact.value + error,
            std=math.sqrt(p.bias**2 + p.drift**2 + p.noise**2),
            path=exact.path + np.column_stack([np.zeros(len(back)), error * back]),
            hitch_direction=exact.hitch_direction - error / self._follow_distance,
            path_tangent=exact.path_tangent - error / self._follow_distance,
            v_x=exact.v_x + float(v_x),
            v_y=exact.v_y + float(v_y),
            yaw_rate=exact.yaw_rate + p.yaw_rate_noise * float(normal[2]),
        )
