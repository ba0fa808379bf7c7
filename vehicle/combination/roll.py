"""Roll of bodies on axles with springs and tyres, coupled through the hitches, and static rollover.

For vehicles whose files give the springs: ``suspension`` of every axle, ``roll`` of every unit and ``coupling`` where a
hitch transmits a roll moment.

A massless axle with the angle a on its tyres carries the body with the angle phi at its roll centre, h above the
ground. The suspension's moment is K (phi - a). About the ground, the side force F of the tyres, the load W and this
moment are carried by the tyres: K (phi - a) + h F + W h a = K_t a, at most W T / 2 of the load W on the track T. Then
one side has lifted, and the moment stays while the axle follows the body. So axles lift one after the other, and only
the others still resist. Dampers act like an additional angle of the body, as far as that changes the wheels' loads: an
axle that has lifted moves with its body.

The moment on the body about its centre of gravity, + rolls its left side up: (H - h) (F + W phi) of each axle, the same
of the hitches' forces, less the springs' moments. The side forces act without the lateral motion of the body over its
roll axis, whose inertia is therefore about that axis.

A fifth wheel transmits a moment through its plate until the trailer separates from one edge of it, at load times half
the width. Then the moment stays over the lash, up to where the kingpin's collar catches. Twist of the tractor's frame
is in series with the springs of its front axles, twist of a trailer's frame with its fifth wheel. Not modelled: twist
under the weight of the body's own front part, lateral compliance of the tyres, lash of leaf springs.

In a steady turn on level ground all axles carry side force in proportion to their load. The lateral acceleration rises
until the bodies have no stable equilibrium any more.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import casadi as ca
import numpy as np

from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.multibody import Vector, solve_ldl
from vehicle.combination.unit import Axle, Coupling, Suspension, Unit
from vehicle.frames import FloatArray
from vehicle.tyres import Num

LYING: Final = 1.0  # [rad] a body that rolls further lies on its side, and moments no longer grow


class AxleSpring(NamedTuple):
    """Springs of an axle, and its equilibrium with the axle's own angle eliminated."""

    suspension: Num  # with the frame in series [N m/rad]
    tyres: Num  # [N m/rad]
    height: Num  # of the roll centre [m]
    lever: Num  # of the body's centre of gravity above it [m]
    weight: Num  # static load [N]
    track: Num  # [m]

    @property
    def swing(self) -> Num:
        """Angle of the axle over the moment from body and side force, on both wheels [rad/(N m)]."""
        return 1.0 / (self.tyres + self.suspension - self.weight * self.height)

    @property
    def stiffness(self) -> Num:
        """Moment on the body over its angle, on both wheels [N m/rad]."""
        return self.suspension * (self.tyres - self.weight * self.height) * self.swing

    @property
    def rise(self) -> Num:
        """Moment on the body over the side force, on both wheels [m]."""
        return self.lever + self.suspension * self.height * self.swing

    def transfer(self, lean: Num, force: Num) -> Num:
        """Load moved from left to right [N] by the angle of the body over the road [rad] and side force [N].

        The angle is the ``lean``, which has the dampers in it. More than half the load means that a side has lifted.
        """
        per_moment = self.tyres * self.swing / self.track
        return (per_moment * self.suspension) * lean + (per_moment * self.height) * force

    def body_moment(self, angle: Num, force: Num, right_less_left: Num) -> Num:
        """Moment on the body about its centre of gravity [N m], from its angle, the side force and the wheels' loads.

        The angle is that over the road [rad]: dampers act through the wheels' loads alone, so that they are gone when a
        side has lifted. The body's weight is not in it.
        """
        return (
            (self.lever + self._follow * self.height) * force
            + (self._follow * self.weight * self.height) * angle
            - (self._follow * 0.5 * self.track) * right_less_left
        )

    @property
    def through_wheels(self) -> Num:
        """Moment of the wheels' loads on the body over its lean [N m/rad]; the ``stiffness`` without the weight."""
        return self._follow * self.suspension * self.tyres * self.swing

    @property
    def _follow(self) -> Num:
        """Angle of the axle over that of the body while a side has lifted [-]."""
        return self.suspension / (self.suspension - self.weight * self.height)


class UnitSprings(NamedTuple):
    """Springs of a unit's axles, and of its front hitch."""

    axles: list[AxleSpring]
    inertia: Num  # of the body about its roll axis [kg m2]
    stiffness: Num  # of all axles [N m/rad]
    damping: Num  # of all axles over the inertia [1/s]
    hitch: "Num | None"  # roll stiffness at the front hitch, frame in series [N m/rad]; None: it transmits no moment
    coupling: Coupling | None

    @property
    def time(self) -> Num:
        """Lean over rate of roll [s]: dampers act as a larger angle, through the wheels' loads."""
        return self.damping * self.inertia / sum(axle.through_wheels for axle in self.axles)

    def hitch_moment(self, twist: Num, load: Num) -> Num:
        """Moment [N m] through the front hitch, twisted by an angle [rad] under its load [N]."""
        if self.hitch is None or self.coupling is None:
            return 0.0
        moment = self.hitch * twist
        separation = (0.5 * self.coupling.plate_width) * ca.fmax(load, 0.0)
        caught = separation + self.hitch * self.coupling.lash
        within = ca.fmin(ca.fmax(moment, -separation), separation)
        return within + (moment - ca.fmin(ca.fmax(moment, -caught), caught))


def springs_of(vehicle: Vehicle) -> list[UnitSprings]:
    """Springs of all units of a vehicle whose file gives them."""
    loads = static_axle_loads(vehicle)
    return [
        _unit_springs(unit, of_unit, towed=i > 0)
        for i, (unit, of_unit) in enumerate(zip(vehicle.units, loads, strict=True))
    ]


def _unit_springs(unit: Unit, loads: Sequence[Num], *, towed: bool) -> UnitSprings:
    assert unit.roll is not None
    frame = unit.roll.frame_stiffness
    front = sum(_suspension(axle).roll_stiffness for axle in unit.axles if _suspension(axle).at_front)
    axles = [
        AxleSpring(
            suspension=_suspension(axle).roll_stiffness
            * (1.0 if frame is None or not _suspension(axle).at_front else _series(frame, front)),
            tyres=_suspension(axle).tyre_roll_stiffness(axle.track, axle.twin_spacing),
            height=_suspension(axle).roll_centre_height,
            lever=unit.cg_height - _suspension(axle).roll_centre_height,
            weight=load,
            track=axle.track,
        )
        for axle, load in zip(unit.axles, loads, strict=True)
    ]
    inertia = unit.roll.inertia + unit.mass * (unit.cg_height - unit.roll_axis_height) ** 2
    stiffness = sum(axle.stiffness for axle in axles)
    dampers = [damper for damper in (_suspension(axle).roll_damping for axle in unit.axles) if damper is not None]
    damping = sum(dampers) / inertia if dampers else 2.0 * unit.suspension_damping * ca.sqrt(stiffness / inertia)
    coupling = unit.coupling if towed else None
    hitch = None
    if coupling is not None:
        hitch = coupling.roll_stiffness * (1.0 if frame is None else _series(frame, coupling.roll_stiffness))
    return UnitSprings(
        axles=axles, inertia=inertia, stiffness=stiffness, damping=damping, hitch=hitch, coupling=coupling
    )


def _series(frame: Num, springs: Num) -> Num:
    """Stiffness of springs behind a frame over that of the springs alone [-]."""
    return frame / (frame + springs)


def _suspension(axle: Axle) -> Suspension:
    assert axle.suspension is not None
    return axle.suspension


class Hitch(NamedTuple):
    """Action on a towed unit at its front hitch."""

    force: Vector  # along its own axes [N]
    ahead: Vector  # the same along the axes of the unit ahead [N]
    load: Num  # upward [N]
    cosine: Num  # of the articulation


def body_moments(
    vehicle: Vehicle,
    springs: Sequence[UnitSprings],
    roll: Sequence[Num],
    axle_loads: Sequence[Sequence[Num]],
    axle_moments: Sequence[Sequence[Num]],
    hitches: Sequence[Hitch],
) -> list[Num]:
    """Roll moment [N m] on every body about its centre of gravity, + left side up.

    ``axle_loads`` [N] act beside it as it rolls, ``axle_moments`` [N m] are those of ``AxleSpring.body_moment``;
    ``hitches`` are those behind each unit but the last.
    """
    moments: list[Num] = []
    for of_unit, loads, of_axles, angle in zip(springs, axle_loads, axle_moments, roll, strict=True):
        beside = sum(spring.lever * load for spring, load in zip(of_unit.axles, loads, strict=True))
        moments.append(sum(of_axles) + beside * angle)
    for i, hitch in enumerate(hitches, start=1):
        ahead, behind = vehicle.units[i - 1], vehicle.units[i]
        height = ahead.rear_hitch[1]
        twist = hitch.cosine * roll[i] - roll[i - 1]
        through = springs[i].hitch_moment(twist, hitch.load)
        moments[i - 1] = (
            moments[i - 1] - (ahead.cg_height - height) * (hitch.ahead.y + hitch.load * roll[i - 1]) + through
        )
        moments[i] = (
            moments[i] + (behind.cg_height - height) * (hitch.force.y + hitch.load * roll[i]) - hitch.cosine * through
        )
    return moments


def settled_rolls(vehicle: Vehicle, springs: Sequence[UnitSprings], specific_y: Sequence[Num]) -> list[Num]:
    """Steady roll [rad] of every body of the straight combination under specific forces to the left [m/s2].

    All wheels are on the ground and no fifth wheel separates, so the equations are linear.
    """
    units = range(len(vehicle.units))
    forces = [[spring.weight * specific_y[i] / GRAVITY for spring in springs[i].axles] for i in units]
    loads = [[spring.weight for spring in springs[i].axles] for i in units]
    couplings = hitch_loads(vehicle, loads)
    matrix: list[list[Num]] = [[0.0] * len(units) for _ in units]
    right: list[Num] = []
    for i in units:
        matrix[i][i] = springs[i].stiffness - sum(spring.lever * spring.weight for spring in springs[i].axles)
        right.append(sum(spring.rise * force for spring, force in zip(springs[i].axles, forces[i], strict=True)))
    for i in units[1:]:
        height, load = vehicle.units[i - 1].rear_hitch[1], couplings[i]
        force = load * specific_y[i] / GRAVITY
        for k, sign in ((i, 1.0), (i - 1, -1.0)):
            lever = sign * (vehicle.units[k].cg_height - height)
            matrix[k][k] = matrix[k][k] - lever * load
            right[k] = right[k] + lever * force
        stiffness = springs[i].hitch
        if stiffness is not None:
            matrix[i][i] = matrix[i][i] + stiffness
            matrix[i - 1][i - 1] = matrix[i - 1][i - 1] + stiffness
            matrix[i][i - 1] = matrix[i - 1][i] = -stiffness
    return solve_ldl(matrix, right)


def hitch_loads(vehicle: Vehicle, axle_loads: Sequence[Sequence[Num]]) -> list[Num]:
    """Static load [N] of each unit on the hitch ahead of it, from those of the axles; 0 of the first unit."""
    loads: list[Num] = [0.0] * len(vehicle.units)
    behind: Num = 0.0
    for i in reversed(range(1, len(vehicle.units))):
        behind = vehicle.units[i].mass * GRAVITY + behind - sum(axle_loads[i])
        loads[i] = behind
    return loads


_STEP: Final = 0.1  # [m/s2] of the search; the equilibrium of one is near that of the next
_RESOLUTION: Final = 1e-4  # [m/s2] of the threshold
_HIGHEST: Final = 3.0 * GRAVITY  # [m/s2]
_ITERATIONS: Final = 30  # moments are linear between the points where an axle lifts: Newton's method needs few
_CONVERGED: Final = 1e-9  # [rad]
_NUDGE: Final = 1e-7  # [rad] of the numeric slope


class Rollover(NamedTuple):
    """Static rollover of a vehicle in a turn to the left."""

    threshold: float  # lateral acceleration beyond which it tips [m/s2]
    roll: tuple[float, ...]  # of every body just below it [rad]
    lifted: tuple[tuple[bool, ...], ...]  # axles of every unit of which a side has lifted there


class _RollBalance:
    """Moments on the bodies of a vehicle in a steady turn."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle, self._springs = vehicle, springs_of(vehicle)
        self._loads = static_axle_loads(vehicle)
        self._hitch_loads = [float(load) for load in hitch_loads(vehicle, self._loads)[1:]]

    def moments(self, roll: FloatArray, acceleration: float) -> FloatArray:
        """Roll moments [N m] at these rolls [rad]; 0 in equilibrium."""
        share = acceleration / GRAVITY
        hitches = [Hitch(Vector(0.0, share * load), Vector(0.0, share * load), load, 1.0) for load in self._hitch_loads]
        held: list[list[Num]] = [
            [
                spring.body_moment(float(roll[i]), share * load, right_less_left)
                for spring, load, right_less_left in zip(springs.axles, self._loads[i], excess, strict=True)
            ]
            for i, (springs, excess) in enumerate(zip(self._springs, self.excess(roll, acceleration), strict=True))
        ]
        moments = body_moments(self._vehicle, self._springs, roll.tolist(), self._loads, held, hitches)
        return np.array([float(moment) for moment in moments])

    def excess(self, roll: FloatArray, acceleration: float) -> list[list[float]]:
        """Right less left wheel load of every axle of every unit [N]."""
        share = acceleration / GRAVITY
        return [
            [
                float(np.clip(2.0 * float(spring.transfer(float(roll[i]), share * load)), -load, load))
                for spring, load in zip(springs.axles, self._loads[i], strict=True)
            ]
            for i, springs in enumerate(self._springs)
        ]

    def slopes(self, roll: FloatArray, acceleration: float) -> FloatArray:
        """Moments over rolls [N m/rad]."""
        here = self.moments(roll, acceleration)
        nudges = _NUDGE * np.eye(len(roll))
        return np.column_stack([(self.moments(roll + nudge, acceleration) - here) / _NUDGE for nudge in nudges])

    def equilibrium(self, roll: FloatArray, acceleration: float) -> FloatArray | None:
        """Stable rolls [rad] near these; None if there are none."""
        for _ in range(_ITERATIONS):
            slopes = self.slopes(roll, acceleration)
            if np.linalg.eigvals(slopes).real.max() >= 0.0:
                return None
            step = np.linalg.solve(slopes, self.moments(roll, acceleration))
            roll = roll - step
            if np.abs(step).max() < _CONVERGED:
                return roll
        return None

    def lifted(self, roll: FloatArray, acceleration: float) -> tuple[tuple[bool, ...], ...]:
        """Axles of every unit of which a side has lifted."""
        return tuple(
            tuple(abs(excess) >= load for excess, load in zip(of_unit, loads, strict=True))
            for of_unit, loads in zip(self.excess(roll, acceleration), self._loads, strict=True)
        )


def static_rollover(vehicle: Vehicle) -> Rollover:
    """Static rollover of a vehicle whose suspensions are given.

    Raises:
        ValueError: if it does not stand, or tips at no acceleration of a road vehicle.
    """
    stand = _RollBalance(vehicle)
    roll: FloatArray | None = stand.equilibrium(np.zeros(len(vehicle.units)), 0.0)
    if roll is None:
        raise ValueError(f"{vehicle.name} falls over where it stands: its roll stiffness does not carry its bodies")
    low, step = 0.0, _STEP
    while step > _RESOLUTION:
        if low > _HIGHEST:
            raise ValueError(f"{vehicle.name} does not tip below {_HIGHEST / GRAVITY:g} g")
        found = stand.equilibrium(roll, low + step)
        if found is None:
            step *= 0.5
        else:
            roll, low = found, low + step
    return Rollover(low, tuple(roll.tolist()), stand.lifted(roll, low))


def roll_gradients(vehicle: Vehicle) -> tuple[float, ...]:
    """Roll of every body over lateral acceleration [rad/(m/s2)], all wheels on the ground."""
    if not vehicle.has_springs:
        return tuple(unit.roll_swing[0] for unit in vehicle.units)
    rolls = settled_rolls(vehicle, springs_of(vehicle), [1.0] * len(vehicle.units))
    return tuple(float(roll) for roll in rolls)
