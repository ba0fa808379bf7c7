"""Tyre data common to all laws, and tyre forces through the deflection of an elastic carcass.

Each direction of each wheel has a deflection state n: the force over load that it would cause at the nominal load.
Sliding builds it up and it decays, n' = C_0 V_s / sigma - decay n; the force is n times the load and a factor for that
load. A law gives the decay rate: with decay = speed / sigma * (linear force / steady force) the steady state is the law
at every speed, and n stays bounded by about the friction. Both directions have one decay rate, so a sliding wheel pulls
along its stiffness-weighted slip.

Only rolling and sliding relax a tyre: one that stands keeps its deflection, and so its force, for good. Slip is not
defined at rest; there a tyre that slides slowly has the slip of about its largest force (`slip_speed`), so that its
deflection grows to the limit of the friction and no further.

The carcass is damped: the force is that of n + d n'. The lag of the force must stay sigma / speed all the same.
Across the wheel d falls to 0 at ``CREEPING_SPEED``, from where on the force relaxes by the textbook's first-order
equation. Along the wheel d stays, for it damps the spin of a wheel on its carcass, in series with the sliding contact:
n' = (push - decay n) / (1 + d decay). With that a step of slip is answered at once by a share d decay / (1 + d decay),
without overshoot, and the area between step and response is still sigma / speed.

The side force acts behind the wheel's centre by the pneumatic trail, which vanishes as the contact patch slides. Not
modelled: turn slip, and camber but by tyre files.

A twin wheel counts as one, also where its two contact patches slip each by itself. Stiffnesses and forces are over the
vertical load. Every method takes numbers or ``casadi.SX``, and so may be the data.
"""

from abc import ABC, abstractmethod
from typing import Annotated, Final, NamedTuple, TypeAlias

import casadi as ca

from vehicle.foundation.quantity import Frozen, quantity

Num: TypeAlias = "float | ca.SX"

ROLLING_SPEED_FLOOR: Final = 0.05  # below it slip is not defined well: see `slip_speed` [m/s]
CREEPING_SPEED: Final = 1.35  # at which damping across the wheel has gone: below 5 km/h [m/s]
_PEAK_DEMAND: Final = 3.0  # linear force over the limit at the largest force: of a brush; truck tyres 2 to 5
_LEAST_DAMPING: Final = 2e-3  # of a carcass: less lets light wheels swing up in steps of 1 ms [s]
_TINY: Final = 1e-12  # square of a rate [1/s2]: avoids 0 / 0


class Planar(NamedTuple):
    """A quantity of a wheel along (x, forward) and across (y, left) its plane."""

    x: Num
    y: Num


class Grip(NamedTuple):
    """Tyre-law output: decay rate of the deflection, and the scale and limit of the force."""

    decay: Num  # rate at which a deflection decays [1/s]
    limit: Num  # largest force over load in any direction [-]
    factor: Num  # stiffness over the nominal one, along the wheel [-]
    skew: Num  # the same across, over that along [-]
    factor_by_limit: Num  # factor / limit [-]
    trail: Num  # distance behind the wheel's centre at which the side force acts when rolling forward [m]
    across: "Num | None" = None  # decay rate across the wheel, where it differs from that along [1/s]
    shift: Planar = Planar(0.0, 0.0)  # rate that offsets and camber add to that of sliding [1/s]
    moment: Num = 0.0  # about the vertical besides that of the side force, + left [N m]

    @property
    def decays(self) -> Planar:
        """Decay rates along and across the wheel [1/s]."""
        return Planar(self.decay, self.decay if self.across is None else self.across)


class Carcass(NamedTuple):
    """Motion of the damped carcass, and the deflection that gives its force."""

    rate: Planar  # of the deflection [1/s]
    felt: Planar  # n + d n', to which the force is in proportion [-]
    at_once: Num  # rise of ``felt`` along the wheel at once with the sliding rate [s]


class Contact(NamedTuple):
    """Tyre force and its sensitivities."""

    force: Planar  # [N]
    per_deflection: Num  # along the wheel [N]
    use_along: Num  # squared share of the largest force that acts along the wheel [-]


def rolling_speed(v_x: Num) -> Num:
    """Magnitude of v_x [m/s], at least the floor, for output: slip is finite at rest."""
    return ca.fmax(ca.fabs(v_x), ROLLING_SPEED_FLOOR)


def slip_speed(speed: Num, pull: Num, relaxation_length: Num) -> Num:
    """Speed [m/s] over which slip is taken, never quite zero: that of rolling, but at rest in proportion to sliding.

    ``pull`` is the rate at which sliding builds up force, over its limit [1/s]. Slowly sliding at rest then is a demand
    of three times the limit, the largest force of a brush. Beyond some cm/s the floor makes it full sliding.
    """
    return ca.fmax(speed, ca.fmin((relaxation_length / _PEAK_DEMAND) * pull, ROLLING_SPEED_FLOOR))


def magnitude(rate: Planar) -> Num:
    """Magnitude of a deflection rate [1/s], never quite zero."""
    return ca.sqrt(rate.x**2 + (rate.y**2 + _TINY))


def carcass(n: Planar, sliding: Planar, decay: "Num | Grip", damping: Num, v_x: Num) -> Carcass:
    """Motion of a carcass deflected by n at v_x [m/s], with ``sliding`` from ``Tyre.sliding_rate`` [1/s].

    ``decay`` is that of a grip, or a rate for both directions [1/s].
    """
    along, across = decay.decays if isinstance(decay, Grip) else (decay, decay)
    if isinstance(decay, Grip):
        sliding = Planar(sliding.x + decay.shift.x, sliding.y + decay.shift.y)
    d = ca.fmax(damping, _LEAST_DAMPING)
    per_damping = 2.0 / (2.0 * d)  # 1 / d, written so that CasADi divides once and not by d at every use
    at_once = 1.0 / (per_damping + along)
    damped = at_once * (sliding.x - along * n.x)
    rate_y = sliding.y - across * n.y
    damping_y = ca.fmax(d - (d / CREEPING_SPEED) * ca.fabs(v_x), 0.0)
    return Carcass(Planar(per_damping * damped, rate_y), Planar(n.x + damped, n.y + damping_y * rate_y), at_once)


def contact(felt: Planar, F_z: Num, grip: Grip) -> Contact:
    """Force of a tyre whose carcass presses with the deflection ``felt``, bounded by its limit."""
    x = felt.x
    y = grip.skew * felt.y
    over_x, over_y = grip.factor_by_limit * x, grip.factor_by_limit * y  # over the limit
    demand = ca.fmax(over_x**2 + over_y**2, 1.0)  # squared; at least 1
    scale = (F_z * grip.factor) / ca.sqrt(demand)
    return Contact(Planar(scale * x, scale * y), scale, over_x**2 / demand)


_STIFF: Final = "tyres have 3 to 20, stiff ones in tests up to 60"
Stiffness = Annotated[float, quantity(..., "-", 0.1, 60.0, why=_STIFF)]  # per unit of slip (tangent of the slip angle)
_OVERLOAD: Final = 2.0  # wheel load over its tyre's nominal load, up to which tyre data are given
_LEAST_STIFFNESS: Final = 0.2  # of the nominal one: the straight line is fitted between one and two nominal loads


class Tyre(Frozen, ABC):
    """An elastic carcass with some law of the steady force."""

    model: str  # name of the law
    name: str = ""  # of its table in the vehicle file
    nominal_load: float = quantity(
        ..., "N", 300.0, 1e6, why="300 N is a trailer's wheel, 1e6 N a dumper's; loads are in N, not kg"
    )  # per wheel
    relaxation_length: float = quantity(
        ..., "m", 1e-3, 3.0, why="0.1 m to 1 m; a shorter one is too stiff for a step of 1 ms"
    )
    # Of the carcass: damping over stiffness
    damping: float = quantity(..., "s", 0.0, 0.2, why="rubber has 0.001 s to 0.1 s; with more a tyre is a damper")
    # Rolling drag over load
    rolling_resistance: float = quantity(..., "-", 0.0, 0.3, why="0.005 to 0.01 on asphalt, 0.3 in deep sand")
    pneumatic_trail: float = quantity(
        ..., "m", 0.0, 0.3, why="a sixth of the contact patch, which is at most 1 m long, and a margin"
    )  # at small slip and nominal load; 0: no moment

    @property
    def load_range(self) -> Planar:
        """Least and largest load per wheel that the data are given for [N]."""
        return Planar(0.0, _OVERLOAD * self.nominal_load)

    @property
    def relaxation_along(self) -> float:
        """Relaxation length along the wheel at the nominal load [m]."""
        return self.relaxation_length

    def on_wheel(self, side: int, camber: Num) -> "Tyre":
        """The tyre on a wheel of one side (+1 left, -1 right), tilted by ``camber`` [rad], + top to the right."""
        return self

    @property
    @abstractmethod
    def nominal_stiffness(self) -> Planar:
        """Slip stiffness over load along and across the wheel at the nominal load [-]."""

    @abstractmethod
    def grip(self, F_z: Num, friction: Num, sliding: Planar, speed: Num) -> Grip:
        """Output of the law at a load [N], friction [-], ``sliding_rate`` [1/s] and speed of rolling, |v_x| [m/s]."""

    @abstractmethod
    def with_cornering_scaled(self, factor: float) -> dict[str, object]:
        """Fields of this tyre, to be validated, with the initial slope of the lateral force multiplied by ``factor``.

        Longitudinal stiffness and friction stay.
        """

    def sliding_rate(self, gain: Num, drift: Num) -> Planar:
        """Rate at which sliding builds up the deflection [1/s].

        ``gain`` is the speed of the tread to the rear over the ground, which pulls the wheel forward; ``drift`` is the
        wheel's velocity to the left, which pulls it to the right [m/s].
        """
        C, per_length = self.nominal_stiffness, 1.0 / self.relaxation_length
        return Planar((C.x * (1.0 / self.relaxation_along)) * gain, (-C.y * per_length) * drift)

    def trail(self, F_z: Num, remaining: Num) -> Num:
        """Pneumatic trail [m]; ``remaining`` is the share that sliding leaves of it.

        It grows with load as the tangent to the root does, for the contact patch of a round tyre grows with the root of
        the load. Laws without a moment of their own leave the unused share of the largest force, within 0.15 of what a
        brush leaves.
        """
        half = 0.5 * self.pneumatic_trail
        return (half + (half / self.nominal_load) * F_z) * remaining

    def stiffness(self, F_z: Num) -> Planar:
        """Slip stiffness over load along and across the wheel [-]."""
        C, grip = self.nominal_stiffness, self.grip(F_z, 1.0, Planar(0.0, 0.0), 1.0)
        return Planar(grip.factor * C.x, grip.factor * grip.skew * C.y)

    def steady_force(self, slip: Planar, F_z: Num, friction: Num) -> Planar:
        """Force [N] at a steady slip [-], at which the deflection no longer changes."""
        sliding = self.sliding_rate(slip.x, -slip.y)
        grip = self.grip(F_z, friction, sliding, 1.0)
        per_rate = F_z * grip.factor / grip.decay
        across = per_rate if grip.across is None else F_z * grip.factor / grip.across
        return Planar(per_rate * (sliding.x + grip.shift.x), across * grip.skew * (sliding.y + grip.shift.y))


class StiffnessTyre(Tyre):
    """Base of the laws whose stiffness falls linearly with load, and whose largest force is friction times load."""

    cornering_stiffness: float = quantity(..., "1/rad", 0.1, 60.0, why=_STIFF)  # at the nominal load
    longitudinal_stiffness: Stiffness  # at the nominal load
    # Relative loss of stiffness, per nominal load
    load_sensitivity: float = quantity(..., "-", 0.0, 1.0, why="at 1 twice the nominal load leaves no stiffness")

    @property
    def nominal_stiffness(self) -> Planar:
        """Slip stiffness over load along and across the wheel at the nominal load [-]."""
        return Planar(self.longitudinal_stiffness, self.cornering_stiffness)

    def with_cornering_scaled(self, factor: float) -> dict[str, object]:
        """Fields of this tyre with the cornering stiffness multiplied by ``factor``."""
        return self.model_dump() | {"cornering_stiffness": factor * self.cornering_stiffness}

    def load_factor(self, F_z: Num) -> Num:
        """Stiffness over load, over that at the nominal load [-]; it falls with load."""
        per_newton = self.load_sensitivity / self.nominal_load
        return ca.fmax((1.0 + self.load_sensitivity) - per_newton * F_z, _LEAST_STIFFNESS)
