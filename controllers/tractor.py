"""The driver's data sheet of the tractor, and its lateral motion as the driver knows it.

The axles ahead of and behind the middle of the wheelbase count as one group each, at their stiffness-weighted places.
The trailers are a mass on the hitch that moves sideways with it, which is their reaction in steady turns. With the slip
angles a of the relaxed groups, over the total mass:

    d(v_y)/dt + x_m dr/dt + v r = -c_f a_f - c_r a_r
    x_m d(v_y)/dt + k dr/dt + x_m v r = -x'_f c_f a_f - x'_r c_r a_r
    sigma da/dt = v_y + x r - v rho delta - v a

Forces act the trail behind the groups' places, at x'. The spread of a group resists turning; this scrubbing counts in
tight turns only, and is left to the law.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from vehicle.combination.description import GRAVITY
from vehicle.frames import FloatArray


class TractorAxle(NamedTuple):
    """An axle of the tractor on its tyres, as laden."""

    x: float  # in T [m]
    stiffness: float  # cornering stiffness of all its tyres [N/rad]
    relaxation_length: float  # of its tyres [m]
    trail: float = 0.0  # pneumatic trail [m]
    steer_ratio: float = 0.0  # angle over that of the foremost steered axle [-]; 0: not steered


@dataclass(frozen=True, slots=True, kw_only=True)
class TractorDynamics:
    """Masses and tyres of the tractor, for its lateral motion at speed."""

    mass: float  # [kg]
    yaw_inertia: float  # about the centre of gravity [kg m2]
    cg_x: float  # in T [m]
    hitch_mass: float = 0.0  # share of the trailers' mass that rests on the hitch and moves sideways with it [kg]
    hitch_x: float = 0.0  # in T [m]
    axles: tuple[TractorAxle, ...]  # front to rear

    def __post_init__(self) -> None:
        if self.hitch_mass < 0.0:
            raise ValueError(f"hitch_mass = {self.hitch_mass} kg must not be negative")
        for axle in self.axles:
            _check_positive("stiffness", axle.stiffness)


@dataclass(frozen=True, slots=True, kw_only=True)
class TractorGeometry:
    """The driver's data sheet of the tractor: size, guided point and steering actuator, masses and tyres."""

    wheelbase: float  # [m]
    x_ref: float  # guided point in T [m]
    y_ref: float  # [m], + left
    max_steer: float  # road-wheel angle [rad]
    max_steer_rate: float  # [rad/s]
    actuator_lag: float  # first-order time constant [s]
    dynamics: TractorDynamics | None = None  # None: as of a usual laden tractor of this wheelbase

    def __post_init__(self) -> None:
        for name in ("wheelbase", "x_ref"):
            _check_positive(name, getattr(self, name))


def _check_positive(name: str, value: float) -> None:
    if not value > 0.0:
        raise ValueError(f"{name} = {value} must be positive")


STATES: Final = 7  # offset, heading error, v_y, yaw rate, slip of front and rear group, steer

# A usual laden tractor, per kg of it and the load on its fifth wheel, for a data sheet without masses.
_CG: Final = 0.4  # over the wheelbase
_GYRATION: Final = 0.4  # radius over the wheelbase
_STIFFNESS: Final = 5.5  # cornering stiffness over load [1/rad]
_RELAXATION: Final = 0.5  # [m]


class Group(NamedTuple):
    """A group of axles."""

    x: float  # in T [m]
    force_x: float  # where its side force acts [m]
    stiffness: float  # over the total mass [m/s2 per rad]
    relaxation_length: float  # [m]
    steer_ratio: float  # angle of its mean wheel over that of the foremost steered axle [-]


@dataclass(frozen=True, slots=True)
class TractorModel:
    """Numbers of the lateral motion, over the total mass."""

    front: Group
    rear: Group
    mass_x: float  # centre of gravity with the load on the hitch, in T [m]
    second_moment: float  # of the mass about To [m2]
    scrub: float  # yaw resistance of the groups' spread, per r / v [m3/s2]
    steered_scrub: float  # how much less per steer angle, for steered axles turn with the curve [m2/s2]


@lru_cache(maxsize=32)
def tractor_model(tractor: TractorGeometry) -> TractorModel:
    """The lateral motion of the tractor's data sheet."""
    data = _usual(tractor.wheelbase) if tractor.dynamics is None else tractor.dynamics
    mass = data.mass + data.hitch_mass
    middle = 0.5 * tractor.wheelbase
    groups = [[axle for axle in data.axles if (axle.x > middle) is ahead] for ahead in (True, False)]
    front, rear = (_group(axles, mass) for axles in groups)
    spread = [
        (axle.stiffness * (axle.x - group.x) / mass, axle.x - group.x, axle.steer_ratio - group.steer_ratio)
        for axles, group in zip(groups, (front, rear), strict=True)
        for axle in axles
    ]
    return TractorModel(
        front=front,
        rear=rear,
        mass_x=(data.mass * data.cg_x + data.hitch_mass * data.hitch_x) / mass,
        second_moment=(data.yaw_inertia + data.mass * data.cg_x**2 + data.hitch_mass * data.hitch_x**2) / mass,
        scrub=sum(moment * x for moment, x, _ in spread),
        steered_scrub=sum(moment * ratio for moment, _, ratio in spread),
    )


def _group(axles: list[TractorAxle], mass: float) -> Group:
    if not axles:
        raise ValueError("axles: a tractor has one or more both ahead of and behind the middle of its wheelbase")
    stiffness = sum(axle.stiffness for axle in axles)

    def mean(values: list[float]) -> float:
        return sum(axle.stiffness * value for axle, value in zip(axles, values, strict=True)) / stiffness

    return Group(
        x=mean([axle.x for axle in axles]),
        force_x=mean([axle.x - axle.trail for axle in axles]),
        stiffness=stiffness / mass,
        relaxation_length=mean([axle.relaxation_length for axle in axles]),
        steer_ratio=mean([axle.steer_ratio for axle in axles]),
    )


def _usual(wheelbase: float) -> TractorDynamics:
    front = _STIFFNESS * GRAVITY * _CG
    return TractorDynamics(
        mass=1.0,
        yaw_inertia=(_GYRATION * wheelbase) ** 2,
        cg_x=_CG * wheelbase,
        axles=(
            TractorAxle(wheelbase, front, _RELAXATION, steer_ratio=1.0),
            TractorAxle(0.0, _STIFFNESS * GRAVITY - front, _RELAXATION),
        ),
    )


def path_matrices(
    model: TractorModel, tractor: TractorGeometry, lag: float, speed: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A (7, 7), B (7,) and E (7,) of dx/dt = A x + B demand + E curvature at a speed [m/s], about a straight path.

    States: offset of the guided point from the path [m] and heading of the tractor against it [rad], v_y of To [m/s],
    yaw rate [rad/s], slip of front and rear group [rad], steer [rad]. ``curvature`` is the path's [1/m].
    """
    A, B, E = np.zeros((STATES, STATES)), np.zeros(STATES), np.zeros(STATES)
    A[0, 1:4] = speed, 1.0, tractor.x_ref
    A[1, 3], E[1] = 1.0, -speed
    mass = np.array([[1.0, model.mass_x], [model.mass_x, model.second_moment]])
    forces = np.zeros((2, STATES))
    forces[:, 3] = -speed * mass[:, 0]
    for state, group in ((4, model.front), (5, model.rear)):
        forces[:, state] = -group.stiffness, -group.stiffness * group.force_x
        A[state, 2:4] = 1.0 / group.relaxation_length, group.x / group.relaxation_length
        A[state, state] = -speed / group.relaxation_length
        A[state, 6] = -speed * group.steer_ratio / group.relaxation_length
    A[2:4] = np.linalg.solve(mass, forces)
    A[6, 6], B[6] = -1.0 / lag, 1.0 / lag
    return A, B, E


def rolling_matrices(tractor: TractorGeometry, lag: float, speed: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A (3, 3), B (3,) and E (3,) of a tractor that rolls without slip, with offset, heading error and steer."""
    bend = speed / tractor.wheelbase
    A = np.array([[0.0, speed, tractor.x_ref * bend], [0.0, 0.0, bend], [0.0, 0.0, -1.0 / lag]])
    return A, np.array([0.0, 0.0, 1.0 / lag]), np.array([0.0, -speed, 0.0])
