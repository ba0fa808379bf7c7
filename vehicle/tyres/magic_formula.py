"""The Magic Formula 5.2, 6.1 and 6.2 with the coefficients of a tyre property file.

Pacejka, Tire and Vehicle Dynamics, 3rd edition, section 4.3.2 (equations 4.E1 to 4.E78), for 6.1 and 6.2, whose
horizontal forces are the same; for 5.2 the same with its own camber terms, and with the slip angle in place of its
tangent. Loads, slips and camber beyond the file's ranges count as the range's end; the force over load then stays.

A file's axes are ISO (x forward, y left) if PKY1 is negative, else those of the book (y right). A tyre measured on one
side is mirrored on the other. Without a side, as controllers know it, a tyre is the mean of both: without offsets.

Each direction has a deflection with a decay rate of its own: relaxation lengths are the file's, and shorten as the
contact slides. Offsets and camber add to the rate of sliding. Not modelled: turn slip, overturning moment.
"""

import math
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple

import casadi as ca
from pydantic import create_model

from vehicle.foundation.quantity import Frozen, quantity
from vehicle.tyres.tyre import Grip, Num, Planar, Tyre, magnitude, slip_speed

COEFFICIENTS: Final = {
    "LONGITUDINAL_COEFFICIENTS": "PCX1 PDX1 PDX2 PDX3 PEX1 PEX2 PEX3 PEX4 PKX1 PKX2 PKX3 PHX1 PHX2 PVX1 PVX2 PPX1 PPX2 "
    "PPX3 PPX4 RBX1 RBX2 RBX3 RCX1 REX1 REX2 RHX1 PTX1 PTX2 PTX3",
    "LATERAL_COEFFICIENTS": "PCY1 PDY1 PDY2 PDY3 PEY1 PEY2 PEY3 PEY4 PEY5 PKY1 PKY2 PKY3 PKY4 PKY5 PKY6 PKY7 PHY1 PHY2 "
    "PHY3 PVY1 PVY2 PVY3 PVY4 PPY1 PPY2 PPY3 PPY4 PPY5 RBY1 RBY2 RBY3 RBY4 RCY1 REY1 REY2 RHY1 RHY2 RVY1 RVY2 RVY3 "
    "RVY4 RVY5 RVY6 PTY1 PTY2",
    "ALIGNING_COEFFICIENTS": "QBZ1 QBZ2 QBZ3 QBZ4 QBZ5 QBZ6 QBZ9 QBZ10 QCZ1 QDZ1 QDZ2 QDZ3 QDZ4 QDZ6 QDZ7 QDZ8 QDZ9 "
    "QDZ10 QDZ11 QEZ1 QEZ2 QEZ3 QEZ4 QEZ5 QHZ1 QHZ2 QHZ3 QHZ4 PPZ1 PPZ2 SSZ1 SSZ2 SSZ3 SSZ4",
    "STRUCTURAL": "LONGITUDINAL_STIFFNESS LATERAL_STIFFNESS PCFX1 PCFX2 PCFX3 PCFY1 PCFY2 PCFY3",
    "SCALING_COEFFICIENTS": "LFZO LCX LMUX LEX LKX LHX LVX LXAL LCY LMUY LEY LKY LHY LVY LGAY LKYC LYKA LVYKA LTR LRES "
    "LGAZ LKZC LS LSGKP LSGAL LMUV LGAX",
}
"""Names of the coefficients that are read, by section. Others of a file, such as those of its radius, are not used."""
DEFAULTS: Final = {
    name: float(section == "SCALING_COEFFICIENTS") for section, names in COEFFICIENTS.items() for name in names.split()
} | {"PKY4": 2.0, "LMUV": 0.0}
ASYMMETRIES: Final = "RHX1 PEY3 PHY1 PHY2 PVY1 PVY2 RBY3 RVY1 RVY2 QBZ4 QDZ6 QDZ7 QEZ4 QHZ1 QHZ2 SSZ1"
"""Coefficients that are 0 of a tyre that is its own mirror image; in 5.2 also QDZ3."""

_DIGRESSIVE: Final = 10.0  # how far vertical shifts keep up as friction falls, 4.E8
_LEAST_WEIGHT: Final = 0.02  # of combined slip: a coefficient RCX1 above 1 would turn the force round
_MARGIN: Final = 1.2  # combined forces of a fit may exceed both peaks by some percent
_TINY: Final = 1e-12  # square of a slip: avoids 0 / 0

if TYPE_CHECKING:
    Coefficients = Any
else:
    fields = {name: (float, default) for name, default in DEFAULTS.items()}
    Coefficients = create_model("Coefficients", __base__=Frozen, **fields)


class _Loaded(NamedTuple):
    """Load, pressure and camber of a wheel, and what follows from them."""

    load: Num  # within the range of the file [N]
    dfz: Num  # load over the nominal one, less 1
    dpi: Num  # the same of the pressure
    gamma: Num  # camber in the formulas of the side force [rad]
    along: Num  # slip stiffness over load [-]
    across: Num  # the same, with the sign of PKY1


class _Curve(NamedTuple):
    """A direction's force over load: D sin(C atan(B x - E (B x - atan(B x)))) + V at x = slip + H; B C D = K."""

    K: Num
    C: Num
    D: Num
    E: Num
    E_sign: Num  # part of E that takes the sign of -x
    H: Num
    V: Num

    def secant(self, slip: Num, limited: Num, *, of_angle: bool) -> Num:
        """Force over load without V, over slip + H; of the slip within its range, or of the angle with that tangent."""
        x = limited + self.H
        size = ca.sqrt(x**2 + _TINY)
        z = self.K / (self.C * self.D) * (ca.atan(size) if of_angle else size)
        E = ca.fmin(self.E - self.E_sign * ca.sign(x), 1.0)
        return self.D * ca.sin(self.C * ca.atan(_bent(z, E))) / ca.sqrt((slip + self.H) ** 2 + _TINY)


class PropertyFileTyre(Tyre):
    """Magic Formula with the coefficients of a tyre property file, in SI units."""

    model: Literal["tyre_file"]
    version: Literal["5.2", "6.1", "6.2"]
    measured: Literal["left", "right", "symmetric"]  # side of the vehicle
    combined: bool  # False: each direction by itself, USE_MODE 3
    relaxes_by: Literal["coefficients", "stiffness", "constant"]  # its relaxation lengths
    mounted: Literal["", "left", "right"] = ""  # see ``on_wheel``
    camber: float = 0.0  # of the wheel it is on [rad]
    along_relaxation: float = quantity(..., "m", 1e-3, 3.0, why="0.1 m to 1 m; a shorter one is too stiff for 1 ms")
    reference_friction: float = quantity(1.0, "-", 0.0, 2.0, above=True, why="ice has 0.05, rubber on asphalt 1")
    radius: float = quantity(..., "m", 0.05, 2.1, why="the largest tyre of dumpers has 2.0 m")  # unloaded
    reference_speed: float = quantity(16.7, "m/s", 0.1, 200.0, why="tyres are measured at 10 m/s to 30 m/s")
    pressure: float = quantity(1.0, "Pa", 0.0, 5e6, above=True, why="truck tyres have 8e5 Pa")
    nominal_pressure: float = quantity(1.0, "Pa", 0.0, 5e6, above=True, why="truck tyres have 8e5 Pa")
    loads: tuple[float, float]  # range of the file [N]
    slip_ratios: tuple[float, float]
    slip_angles: tuple[float, float]  # [rad]
    cambers: tuple[float, float]  # [rad]
    coefficients: Coefficients

    @property
    def load_range(self) -> Planar:
        """Least and largest load per wheel that the file is for [N]."""
        return Planar(*self.loads)

    @property
    def relaxation_along(self) -> float:
        """Relaxation length along the wheel at the nominal load [m]."""
        return self.along_relaxation

    def on_wheel(self, side: int, camber: Num) -> "PropertyFileTyre":
        """The tyre on a wheel of one side (+1 left, -1 right), tilted by ``camber`` [rad], + top to the right."""
        return self.model_copy(update={"mounted": "left" if side > 0 else "right", "camber": camber})

    @property
    def nominal_stiffness(self) -> Planar:
        """Slip stiffness over load along and across the wheel at the nominal load [-]."""
        return self.stiffness(self.nominal_load)

    def stiffness(self, F_z: Num) -> Planar:
        """Slip stiffness over load along and across the upright wheel [-]."""
        at = self._loaded(F_z, 0.0)
        return Planar(at.along, ca.fabs(at.across))

    def with_cornering_scaled(self, factor: float) -> dict[str, object]:
        """Fields of this tyre with the cornering stiffness multiplied by ``factor``."""
        scaled = self.coefficients.model_dump() | {"LKY": factor * self.coefficients.LKY}
        return self.model_dump() | {"coefficients": scaled}

    def trail(self, F_z: Num, remaining: Num) -> Num:
        """Pneumatic trail of the upright wheel [m]; ``remaining`` is the share that sliding leaves of it."""
        excess = self.pneumatic_trail - self._file_trail(self.nominal_load)
        return (self._file_trail(F_z) + (excess / self.nominal_load) * F_z) * remaining

    def grip(self, F_z: Num, friction: Num, sliding: Planar, speed: Num) -> Grip:
        """Formulas of both directions, each weighted by the slip in the other one, and those of the moment."""
        c, C0, is_52 = self.coefficients, self.nominal_stiffness, self.version == "5.2"
        mirror = 1.0 if self.mounted == self.measured or self.measured == "symmetric" else -1.0
        at = self._loaded(F_z, mirror * _within(self.camber, self.cambers))
        friction = (1.0 / self.reference_friction) * friction
        along, across = self._along(at, c.LMUX * friction), self._across(at, c.LMUY * friction)
        if not self.mounted:
            along, across = along._replace(H=0.0, V=0.0), across._replace(H=0.0, V=0.0)
        limit = _largest(along.D + ca.fabs(along.V), across.D + ca.fabs(across.V), circle=self.combined)
        length = self._relaxation(at)
        factor = at.along * self.along_relaxation / (C0.x * length.x)
        skew = ca.fabs(at.across) * self.relaxation_length / (C0.y * length.y) / factor
        # Slips, and their parts within the ranges
        by_limit = factor / (_MARGIN * limit)
        pull = by_limit * magnitude(Planar(sliding.x, skew * sliding.y))
        over = slip_speed(speed, pull, self.relaxation_length)
        per_slip = Planar(over * C0.x / self.along_relaxation, over * C0.y / self.relaxation_length)
        kappa, tangent = sliding.x / per_slip.x, -mirror * sliding.y / per_slip.y
        k = _within(kappa, self.slip_ratios)
        t = _within(tangent, (ca.tan(self.slip_angles[0]), ca.tan(self.slip_angles[1])))
        faded = 1.0 / (1.0 + c.LMUV / self.reference_speed * over * ca.sqrt(kappa**2 + tangent**2))
        along, across = along._replace(D=along.D * faded), across._replace(D=across.D * faded)
        # Forces over load, to the left as seen in the mirror
        alpha = ca.atan(t) if is_52 else t
        G_x, G_y, V_y = self._weights(at, k, alpha, across.D) if self.combined else (1.0, 1.0, 0.0)
        to_left = -ca.sign(c.PKY1)
        R_x, R_y = along.secant(kappa, k, of_angle=False), across.secant(tangent, t, of_angle=is_52)
        f_x = G_x * (R_x * (kappa + along.H) + along.V)
        f_y = G_y * (to_left * across.V - R_y * (tangent + across.H)) + to_left * V_y
        grip = Grip(
            decay=over / length.x * along.K / (G_x * R_x),
            across=over / length.y * across.K / (G_y * R_y),
            limit=limit,
            factor=factor,
            skew=skew,
            factor_by_limit=by_limit,
            trail=self._lever(at, alpha, t, k, c.LMUY * friction),
        )
        if not self.mounted:
            return grip
        if is_52:
            prime = f_y - to_left * V_y
        else:  # of the upright wheel
            across_0 = self._across(self._loaded(F_z, 0.0), c.LMUY * friction)
            R_0 = across_0.secant(tangent, t, of_angle=False)
            prime = G_y * (to_left * across_0.V - R_0 * (tangent + across_0.H))
        residual = self._residual(at, across, k, alpha, t, c.LMUY * friction)
        residual = residual + self._arm(at, to_left * f_y) * f_x
        across_shift = to_left * (across.V + V_y / G_y) / R_y - across.H
        return grip._replace(
            shift=Planar(per_slip.x * (along.H + along.V / R_x), mirror * per_slip.y * across_shift),
            moment=mirror * F_z * (to_left * residual + grip.trail * (f_y - prime)),
        )

    def _loaded(self, F_z: Num, camber: Num) -> _Loaded:
        c = self.coefficients
        load, nominal = _within(F_z, self.loads), c.LFZO * self.nominal_load
        dfz, dpi = load / nominal - 1.0, self.pressure / self.nominal_pressure - 1.0
        gamma = c.LGAY * camber if self.version == "5.2" else ca.sin(camber)
        along = (c.PKX1 + c.PKX2 * dfz) * ca.exp(c.PKX3 * dfz) * (1.0 + c.PPX1 * dpi + c.PPX2 * dpi**2) * c.LKX
        at_peak = (c.PKY2 + c.PKY5 * gamma**2) * (1.0 + c.PPY2 * dpi)  # load over the nominal one
        rise = ca.sin(c.PKY4 * ca.atan(load / nominal / at_peak)) * (1.0 - c.PKY3 * ca.fabs(gamma))
        across = c.PKY1 * nominal / load * (1.0 + c.PPY1 * dpi) * rise * c.LKY
        return _Loaded(load, dfz, dpi, gamma, along, across)

    def _along(self, at: _Loaded, mu: Num) -> _Curve:
        c, dfz, dpi = self.coefficients, at.dfz, at.dpi
        mu_peak = (
            (c.PDX1 + c.PDX2 * dfz)
            * (1.0 + c.PPX3 * dpi + c.PPX4 * dpi**2)
            * (1.0 - c.PDX3 * self._scaled(at, c.LGAX) ** 2)
        )
        E = (c.PEX1 + c.PEX2 * dfz + c.PEX3 * dfz**2) * c.LEX
        H, V = (c.PHX1 + c.PHX2 * dfz) * c.LHX, (c.PVX1 + c.PVX2 * dfz) * c.LVX * self._of_shifts(mu)
        return _Curve(at.along, c.PCX1 * c.LCX, mu_peak * mu, E, E * c.PEX4, H, V)

    def _across(self, at: _Loaded, mu: Num) -> _Curve:
        c, dfz, dpi, gamma = self.coefficients, at.dfz, at.dpi, at.gamma
        mu_peak = (c.PDY1 + c.PDY2 * dfz) * (1.0 + c.PPY3 * dpi + c.PPY4 * dpi**2) * (1.0 - c.PDY3 * gamma**2)
        E = (c.PEY1 + c.PEY2 * dfz) * c.LEY
        H, V = (c.PHY1 + c.PHY2 * dfz) * c.LHY, (c.PVY1 + c.PVY2 * dfz) * c.LVY
        V_camber = (c.PVY3 + c.PVY4 * dfz) * gamma
        if self.version == "5.2":
            H, V = H + c.PHY3 * gamma, (V + V_camber) * mu
        else:
            V_camber = V_camber * c.LKYC * self._of_shifts(mu)
            K_camber = (c.PKY6 + c.PKY7 * dfz) * (1.0 + c.PPY5 * dpi) * c.LKYC
            H, V = H + (K_camber * gamma - V_camber) / at.across, V * self._of_shifts(mu) + V_camber
        E_sign = E * (c.PEY3 + c.PEY4 * gamma)
        E = E * (1.0 + c.PEY5 * gamma**2)
        return _Curve(ca.fabs(at.across), c.PCY1 * c.LCY, ca.fabs(mu_peak) * mu, E, E_sign, H, V)

    def _of_shifts(self, mu: Num) -> Num:
        """Friction in the vertical shifts of 6.1 and 6.2, 4.E8."""
        return mu if self.version == "5.2" else _DIGRESSIVE * mu / (1.0 + (_DIGRESSIVE - 1.0) * mu)

    def _weights(self, at: _Loaded, k: Num, alpha: Num, mu_y: Num) -> tuple[Num, Num, Num]:
        """Weights of the forces along and across under combined slip, and side force over load due to slip along."""
        c, dfz, square = self.coefficients, at.dfz, at.gamma**2
        B_x = (c.RBX1 + c.RBX3 * square) * _cos_atan(c.RBX2 * k) * c.LXAL
        B_y = (c.RBY1 + c.RBY4 * square) * _cos_atan(c.RBY2 * (alpha - c.RBY3)) * c.LYKA
        V = mu_y * (c.RVY1 + c.RVY2 * dfz + c.RVY3 * at.gamma) * _cos_atan(c.RVY4 * alpha) * c.LVYKA
        return (
            _weight(alpha, c.RHX1, B_x, c.RCX1, ca.fmin(c.REX1 + c.REX2 * dfz, 1.0)),
            _weight(k, c.RHY1 + c.RHY2 * dfz, B_y, c.RCY1, ca.fmin(c.REY1 + c.REY2 * dfz, 1.0)),
            V * ca.sin(c.RVY5 * ca.atan(c.RVY6 * k)),
        )

    def _relaxation(self, at: _Loaded) -> Planar:
        """Relaxation lengths at a load [m]: those at the nominal load change as the file says."""
        nominal = self._file_relaxation(self._loaded(self.nominal_load, 0.0))
        now = self._file_relaxation(at)
        return Planar(self.along_relaxation * now.x / nominal.x, self.relaxation_length * now.y / nominal.y)

    def _file_relaxation(self, at: _Loaded) -> Planar:
        """Relaxation lengths by the coefficients of the file [m]."""
        c, dfz = self.coefficients, at.dfz
        nominal = c.LFZO * self.nominal_load
        if self.relaxes_by == "coefficients":
            along = at.load / nominal * (c.PTX1 + c.PTX2 * dfz) * ca.exp(c.PTX3 * dfz) * c.LSGKP
            across = c.PTY1 * ca.sin(2.0 * ca.atan(at.load / (c.PTY2 * nominal))) * c.LSGAL * c.LFZO
            return Planar(self.radius * along, self.radius * across * (1.0 - c.PKY3 * ca.fabs(at.gamma)))
        if self.relaxes_by == "stiffness":
            along = c.LONGITUDINAL_STIFFNESS * (1.0 + c.PCFX1 * dfz + c.PCFX2 * dfz**2 + c.PCFX3 * at.dpi)
            across = c.LATERAL_STIFFNESS * (1.0 + c.PCFY1 * dfz + c.PCFY2 * dfz**2 + c.PCFY3 * at.dpi)
            return Planar(at.along * at.load / along, ca.fabs(at.across) * at.load / across)
        return Planar(1.0, 1.0)

    def nominal_lengths(self) -> dict[str, Num]:
        """Relaxation lengths and pneumatic trail at the nominal load by the file [m], by the names of their fields."""
        lengths = self._file_relaxation(self._loaded(self.nominal_load, 0.0))
        trail = self._file_trail(self.nominal_load)
        return {"along_relaxation": lengths.x, "relaxation_length": lengths.y, "pneumatic_trail": trail}

    def _file_trail(self, F_z: Num) -> Num:
        """Pneumatic trail of the upright wheel by the coefficients of the file [m]."""
        c, at = self.coefficients, self._loaded(F_z, 0.0)
        trail: Num = self.radius * (c.QDZ1 + c.QDZ2 * at.dfz) * (1.0 - c.PPZ1 * at.dpi) * c.LTR
        share: Num = at.load / (c.LFZO * self.nominal_load)
        return trail * share

    def _scaled(self, at: _Loaded, scale: Num) -> Num:
        """Camber in other formulas than that of the side force [rad]; in 5.2 each has its own scaling factor."""
        return scale / self.coefficients.LGAY * at.gamma if self.version == "5.2" else at.gamma

    def _lever(self, at: _Loaded, alpha: Num, t: Num, k: Num, mu: Num) -> Num:
        """Pneumatic trail under slip [m]."""
        c, dfz, gamma = self.coefficients, at.dfz, self._scaled(at, self.coefficients.LGAZ)
        slip = alpha + (c.QHZ1 + c.QHZ2 * dfz + (c.QHZ3 + c.QHZ4 * dfz) * gamma if self.mounted else 0.0)
        equivalent = ca.sign(slip) * ca.sqrt(slip**2 + (at.along / at.across * k) ** 2)
        tilted = 1.0 + c.QBZ4 * gamma + c.QBZ5 * ca.fabs(gamma) + c.QBZ6 * gamma**2
        z = (c.QBZ1 + c.QBZ2 * dfz + c.QBZ3 * dfz**2) * tilted * (c.LKY / mu) * equivalent
        E = (c.QEZ1 + c.QEZ2 * dfz + c.QEZ3 * dfz**2) * (
            1.0 + (c.QEZ4 + c.QEZ5 * gamma) * (2.0 / math.pi) * ca.atan(c.QCZ1 * z)
        )
        shape = ca.cos(c.QCZ1 * ca.atan(_bent(z, ca.fmin(E, 1.0)))) * _cos_atan(t)
        bent = 1.0 + c.QDZ3 * (gamma if self.version == "5.2" else ca.fabs(gamma)) + c.QDZ4 * gamma**2
        return self.trail(at.load, bent * shape)

    def _residual(self, at: _Loaded, across: _Curve, k: Num, alpha: Num, t: Num, mu: Num) -> Num:
        """Residual moment over load, in the axes of the file [m]."""
        c, dfz, gamma = self.coefficients, at.dfz, self._scaled(at, self.coefficients.LGAZ)
        slip = ca.sqrt((alpha + across.H + across.V / at.across) ** 2 + (at.along / at.across * k) ** 2)
        B = c.QBZ9 * c.LKY / mu + c.QBZ10 * at.across / across.D
        of_camber = (c.QDZ8 + c.QDZ9 * dfz) * (1.0 + c.PPZ2 * at.dpi) + (c.QDZ10 + c.QDZ11 * dfz) * ca.fabs(gamma)
        D = (c.QDZ6 + c.QDZ7 * dfz) * c.LRES + of_camber * gamma * c.LKZC
        arm: Num = self.radius * D * mu * _cos_atan(t) * _cos_atan(B * slip)
        return arm

    def _arm(self, at: _Loaded, side_force: Num) -> Num:
        """Distance to the left at which the force along acts, in the axes of the file [m]."""
        c = self.coefficients
        by_force = c.SSZ2 * side_force * at.load / (c.LFZO * self.nominal_load)
        arm: Num = self.radius * (c.SSZ1 + by_force + (c.SSZ3 + c.SSZ4 * at.dfz) * self._scaled(at, c.LGAZ)) * c.LS
        return arm


def _bent(z: Num, E: Num) -> Num:
    return z - E * (z - ca.atan(z))


def _cos_atan(x: Num) -> Num:
    """Cosine of the arc tangent."""
    return 1.0 / ca.sqrt(1.0 + x**2)


def _weight(slip: Num, shift: Num, B: Num, C: Num, E: Num) -> Num:
    """Cosine form of the formula over its value without slip."""
    weight, still = (ca.cos(C * ca.atan(_bent(B * x, E))) for x in (slip + shift, shift))
    return ca.fmax(weight / still, _LEAST_WEIGHT)


def _within(value: Num, limits: tuple[Num, Num]) -> Num:
    return ca.fmin(ca.fmax(value, limits[0]), limits[1])


def _largest(along: Num, across: Num, *, circle: bool) -> Num:
    """Largest force of both directions together; without combined slip both at once."""
    return ca.fmax(along, across) if circle else ca.sqrt(along**2 + across**2)
