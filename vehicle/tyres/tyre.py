"""Tyre data common to all laws, as a table ``[tyres.name]`` of a vehicle file gives them, and what a law must define.

A twin wheel counts as one, also where its two contact patches slip each by itself. Stiffnesses and forces are over the
vertical load. Every method takes numbers or ``casadi.SX``, and so may be the data.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Annotated, Final

import casadi as ca

from vehicle.quantities import Frozen, quantity
from vehicle.tyres.bristle import Grip, Num, Planar

_STIFF: Final = "tyres have 3 to 20, stiff ones in tests up to 60"
Stiffness = Annotated[float, quantity("-", ge=0.1, le=60.0, why=_STIFF)]  # per unit of slip (tangent of the slip angle)
_LEAST_STIFFNESS: Final = 0.2  # of the nominal one: the straight line is fitted between one and two nominal loads


class Tyre(Frozen, ABC):
    """An elastic carcass with some law of the steady force."""

    model: str  # name of the law
    name: str = ""  # of its table in the vehicle file
    nominal_load: Annotated[  # per wheel
        float,
        quantity("N", ge=300.0, le=1e6, why="300 N is a trailer's wheel, 1e6 N a dumper's; loads are in N, not kg"),
    ]
    relaxation_length: Annotated[
        float, quantity("m", ge=1e-3, le=3.0, why="0.1 m to 1 m; a shorter one is too stiff for a step of 1 ms")
    ]
    damping: Annotated[  # of the carcass: damping over stiffness
        float, quantity("s", ge=0.0, le=0.2, why="rubber has 0.001 s to 0.1 s; with more a tyre is a damper")
    ]
    rolling_resistance: Annotated[  # rolling drag over load
        float, quantity("-", ge=0.0, le=0.3, why="0.005 to 0.01 on asphalt, 0.3 in deep sand")
    ]
    pneumatic_trail: Annotated[  # at small slip and nominal load; 0: no moment
        float,
        quantity("m", ge=0.0, le=0.3, why="a sixth of the contact patch, which is at most 1 m long, and a margin"),
    ]

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
        return Planar((C.x * per_length) * gain, (-C.y * per_length) * drift)

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
        scale = F_z * grip.factor / grip.decay
        return Planar(scale * sliding.x, scale * grip.skew * sliding.y)


class StiffnessTyre(Tyre):
    """Base of the laws whose stiffness falls linearly with load, and whose largest force is friction times load."""

    cornering_stiffness: Annotated[float, quantity("1/rad", ge=0.1, le=60.0, why=_STIFF)]  # at the nominal load
    longitudinal_stiffness: Stiffness  # at the nominal load
    load_sensitivity: Annotated[  # relative loss of stiffness, per nominal load
        float, quantity("-", ge=0.0, le=1.0, why="at 1 twice the nominal load leaves no stiffness")
    ]

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
