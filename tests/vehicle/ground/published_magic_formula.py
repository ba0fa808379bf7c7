"""The Magic Formula once more, as published: force and moment by the equations in their order, for ISO axes.

5.2: the equations of the manuals of MF-Tyre 5.2 and PAC2002. 6.1: Pacejka, Tire and Vehicle Dynamics, 3rd edition,
section 4.3.2. Nothing of the program is used: plain numbers of a file go in.
"""

from collections.abc import Mapping
from math import atan, cos, exp, pi, sin, sqrt, tan
from typing import NamedTuple


class Published(NamedTuple):
    """Force along and to the left, moment to the left."""

    F_x: float  # [N]
    F_y: float  # [N]
    M_z: float  # [N m]


def sgn(x: float) -> float:
    """Sign of a number."""
    return (x > 0) - (x < 0)


def published(
    c: Mapping[str, float], F_z: float, kappa: float, alpha: float, gamma: float, friction: float, *, is_52: bool
) -> Published:
    """Combined force of a tyre that rolls forward, with ISO signs (a positive slip angle gives a negative force)."""

    def g(name: str) -> float:
        return c.get(name, 1.0 if name.startswith("L") else 0.0)

    Fz0 = g("LFZO") * c["FNOMIN"]
    R0 = c["UNLOADED_RADIUS"]
    dfz = (F_z - Fz0) / Fz0
    dpi = 0.0 if is_52 else (c["INFLPRES"] - c["NOMPRES"]) / c["NOMPRES"]
    a = alpha if is_52 else tan(alpha)
    gx, gy, gz = (gamma * g(name) for name in ("LGAX", "LGAY", "LGAZ")) if is_52 else (sin(gamma),) * 3
    lmux, lmuy = g("LMUX") * friction, g("LMUY") * friction
    vx, vy = (lmux, lmuy) if is_52 else (10 * lmux / (1 + 9 * lmux), 10 * lmuy / (1 + 9 * lmuy))
    # pure longitudinal slip
    SHx = (g("PHX1") + g("PHX2") * dfz) * g("LHX")
    kx = kappa + SHx
    Cx = g("PCX1") * g("LCX")
    mux = (g("PDX1") + g("PDX2") * dfz) * (1 + g("PPX3") * dpi + g("PPX4") * dpi**2) * (1 - g("PDX3") * gx**2) * lmux
    Dx = mux * F_z
    Ex = (g("PEX1") + g("PEX2") * dfz + g("PEX3") * dfz**2) * (1 - g("PEX4") * sgn(kx)) * g("LEX")
    Kx = F_z * (g("PKX1") + g("PKX2") * dfz) * exp(g("PKX3") * dfz) * (1 + g("PPX1") * dpi + g("PPX2") * dpi**2)
    Kx *= g("LKX")
    Bx = Kx / (Cx * Dx)
    SVx = F_z * (g("PVX1") + g("PVX2") * dfz) * g("LVX") * vx
    Fx0 = Dx * sin(Cx * atan(Bx * kx - min(Ex, 1) * (Bx * kx - atan(Bx * kx)))) + SVx

    def lateral(gy: float) -> tuple[float, ...]:
        rise = sin((c.get("PKY4", 2.0)) * atan(F_z / Fz0 / ((g("PKY2") + g("PKY5") * gy**2) * (1 + g("PPY2") * dpi))))
        Ky = g("PKY1") * Fz0 * (1 + g("PPY1") * dpi) * rise * (1 - g("PKY3") * abs(gy)) * g("LKY")
        SH, SV = (g("PHY1") + g("PHY2") * dfz) * g("LHY"), F_z * (g("PVY1") + g("PVY2") * dfz) * g("LVY") * vy
        if is_52:
            SH += g("PHY3") * gy
            SV += F_z * (g("PVY3") + g("PVY4") * dfz) * gy * lmuy
        else:
            Kg = F_z * (g("PKY6") + g("PKY7") * dfz) * (1 + g("PPY5") * dpi) * g("LKYC")
            SVg = F_z * (g("PVY3") + g("PVY4") * dfz) * gy * g("LKYC") * vy
            SH += (Kg * gy - SVg) / Ky
            SV += SVg
        ay = a + SH
        Cy = g("PCY1") * g("LCY")
        muy = (
            (g("PDY1") + g("PDY2") * dfz) * (1 + g("PPY3") * dpi + g("PPY4") * dpi**2) * (1 - g("PDY3") * gy**2) * lmuy
        )
        Ey = (g("PEY1") + g("PEY2") * dfz) * (1 + g("PEY5") * gy**2 - (g("PEY3") + g("PEY4") * gy) * sgn(ay)) * g("LEY")
        By = Ky / (Cy * muy * F_z)
        Fy = muy * F_z * sin(Cy * atan(By * ay - min(Ey, 1) * (By * ay - atan(By * ay)))) + SV
        return Fy, Ky, By, Cy, muy, SH, SV

    Fy0, Ky, By, Cy, muy, SHy, SVy = lateral(gy)
    # combined slip
    B = (g("RBX1") + g("RBX3") * gx**2) * cos(atan(g("RBX2") * kappa)) * g("LXAL")
    E = min(g("REX1") + g("REX2") * dfz, 1)

    def G(s: float, B: float, C: float, E: float) -> float:
        return cos(C * atan(B * s - E * (B * s - atan(B * s))))

    Fx = Fx0 * G(a + g("RHX1"), B, g("RCX1"), E) / G(g("RHX1"), B, g("RCX1"), E)
    B = (g("RBY1") + g("RBY4") * gy**2) * cos(atan(g("RBY2") * (a - g("RBY3")))) * g("LYKA")
    E = min(g("REY1") + g("REY2") * dfz, 1)
    shift = g("RHY1") + g("RHY2") * dfz
    Gy = G(kappa + shift, B, g("RCY1"), E) / G(shift, B, g("RCY1"), E)
    D = muy * F_z * (g("RVY1") + g("RVY2") * dfz + g("RVY3") * gy) * cos(atan(g("RVY4") * a))
    SVyk = D * sin(g("RVY5") * atan(g("RVY6") * kappa)) * g("LVYKA")
    Fy = Gy * Fy0 + SVyk
    # aligning moment
    at = a + g("QHZ1") + g("QHZ2") * dfz + (g("QHZ3") + g("QHZ4") * dfz) * gz

    def eq(s: float) -> float:
        return sgn(s) * sqrt(s**2 + (Kx / Ky * kappa) ** 2)

    Bt = (g("QBZ1") + g("QBZ2") * dfz + g("QBZ3") * dfz**2) * (1 + g("QBZ4") * gz + g("QBZ5") * abs(gz))
    Bt *= g("LKY") / lmuy
    Ct = g("QCZ1")
    bent = 1 + g("QDZ3") * (gz if is_52 else abs(gz)) + g("QDZ4") * gz**2
    Dt = F_z * R0 / Fz0 * (g("QDZ1") + g("QDZ2") * dfz) * (1 - g("PPZ1") * dpi) * bent * g("LTR")
    Et = (g("QEZ1") + g("QEZ2") * dfz + g("QEZ3") * dfz**2) * (
        1 + (g("QEZ4") + g("QEZ5") * gz) * 2 / pi * atan(Bt * Ct * eq(at))
    )
    z = Bt * eq(at)
    t = Dt * cos(Ct * atan(z - min(Et, 1) * (z - atan(z)))) * cos(alpha)
    ar = a + SHy + SVy / Ky
    Br = g("QBZ9") * g("LKY") / lmuy + g("QBZ10") * By * Cy
    Dr = (g("QDZ6") + g("QDZ7") * dfz) * g("LRES") + (g("QDZ8") + g("QDZ9") * dfz) * (1 + g("PPZ2") * dpi) * gz * g(
        "LKZC"
    )
    Dr = F_z * R0 * (Dr + (g("QDZ10") + g("QDZ11") * dfz) * gz * abs(gz) * g("LKZC")) * lmuy * cos(alpha)
    Mzr = Dr * cos(atan(Br * eq(ar)))
    prime = Fy - SVyk if is_52 else Gy * lateral(0.0)[0]
    s = R0 * (g("SSZ1") + g("SSZ2") * Fy / Fz0 + (g("SSZ3") + g("SSZ4") * dfz) * gz) * g("LS")
    return Published(Fx, Fy, -t * prime + Mzr + s * Fx)
