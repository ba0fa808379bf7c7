"""Forces on a rigid wheel in loose soil: stresses under the rim, integrated over its contact.

Wong & Reece 1967 ("Prediction of rigid wheel performance based on the analysis of soil-wheel stresses", J. of
Terramechanics 4) with the lateral shear and the bulldozing of Ishigami et al. 2007 ("Terramechanics-based model for
steering maneuver of planetary exploration rovers on loose soil", J. of Field Robotics 24). The papers themselves were
not read, but public implementations of both. The bulldozing force enters as F_y = F_u + F_s sin(beta): it is 0 for a
wheel that runs straight and complete for one dragged sideways.

A skidding wheel has two zones of shear (Wong & Reece, part II). In front of a transition angle the soil is pushed ahead
and drives the rim; behind it the rim drags over the soil. The transition angle goes from the entry angle (no skid) to
half of it (locked wheel), as in Pavlov & Johnson (robomechanics/3d-terramechanics, 2022).

Angles are measured from the lowest point of the rim, positive towards the entry into the soil. Not modelled: single
grousers (the radius includes them), compaction by a leading wheel (a rear wheel in a rut sinks in as on fresh soil,
which is the worse case), and digging in over time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final, NamedTuple, Protocol

import casadi as ca
import numpy as np

from vehicle.rover.soil import Soil
from vehicle.tyres import Num

GRAVITY: Final = 9.81  # [m/s2]
_POINTS: Final = 6  # of Gauss's quadrature in each of the two zones: see the test of its error
_LARGEST_SIDE_SLIP: Final = math.pi / 4.0  # limit of the measured shear moduli, from Ishigami [rad]
_TURNING: Final = 0.05  # displacement over modulus over which combined shear changes its direction; assumed [-]
_HEAPING: Final = 0.02  # speed of the centre over that of the rim, below which bulldozing fades; assumed [-]
_LEAST_SINKAGE: Final = 1e-6  # over the radius; keeps the derivatives of the angles finite [-]


class Wheel(Protocol):
    """A rigid wheel."""

    @property
    def radius(self) -> float:
        """Radius [m]."""

    @property
    def width(self) -> float:
        """Width [m]."""


class Rolling(NamedTuple):
    """Velocity of a wheel's centre over the speed of its rim: v / |r omega|."""

    along: Num  # 1: rolling without slip, below 1 driving, above 1 skidding [-]
    across: Num  # + left [-]


class SoilForce(NamedTuple):
    """Force and torque of the soil on a wheel, along its axes (x in the direction of rolling, y left, z up)."""

    F_x: Num  # [N]
    F_y: Num  # [N]
    F_z: Num  # [N]
    torque: Num  # about the axle, against the rotation [N m]


def slip_ratio(along: Num) -> Num:
    """Slip ratio [-]: (r omega - v_x) / r omega driving, / v_x skidding, from ``along`` = v_x / r omega [-]."""
    return ca.if_else(along <= 1.0, 1.0 - along, 1.0 / ca.fmax(along, 1.0) - 1.0)


def soil_force(wheel: Wheel, soil: Soil, sinkage: Num, rolling: Rolling) -> SoilForce:
    """Force of the soil on a wheel that rolls forward at a sinkage [m]."""
    contact = _contact(wheel, soil, sinkage, rolling)
    k_x, k_y = _shear_moduli(soil, ca.atan2(ca.fabs(rolling.across), ca.fabs(rolling.along)))
    F_x: Num = 0.0
    F_z: Num = 0.0
    F_u: Num = 0.0  # lateral shear under the rim
    F_s: Num = 0.0  # bulldozing by the side of the wheel
    torque: Num = 0.0
    for theta, weight, sigma in _stressed(soil, contact):
        j_x = _sheared_along(contact, theta, rolling) / k_x
        j_y = -contact.radius * (contact.entry - theta) * rolling.across / k_y
        used_x, used_y = _mobilised(soil, j_x, j_y, rolling, theta)
        strength = soil.cohesion + sigma * ca.tan(soil.friction_angle)
        tau_x, tau_y = strength * used_x, strength * used_y
        s, c = ca.sin(theta), ca.cos(theta)
        area = weight * (contact.radius * wheel.width)
        F_x += area * (tau_x * c - sigma * s)
        F_z += area * (tau_x * s + sigma * c)
        F_u += area * tau_y
        torque += area * (contact.radius * tau_x)
        depth = ca.fmax(contact.radius * (c - ca.cos(contact.entry)), 0.0)
        F_s += weight * _bulldozing(soil, depth) * (contact.radius - depth * c)
    speed = ca.sqrt(rolling.along**2 + rolling.across**2 + _HEAPING**2)
    return SoilForce(F_x, F_u - F_s * (rolling.across / speed), F_z, torque)


class _Contact(NamedTuple):
    """Contact of the rim with the soil."""

    radius: Num  # [m]
    entry: Num  # theta_f [rad]
    leave: Num  # theta_r [rad]
    crest: Num  # theta_m, of the largest pressure [rad]
    transition: Num  # theta_0, between the two zones of shear of a skidding wheel [rad]
    stiffness: Num  # K: pressure over the sinkage in radii to the power of the exponent [Pa]
    exponent: Num  # n [-]


def _contact(wheel: Wheel, soil: Soil, sinkage: Num, rolling: Rolling) -> _Contact:
    slip = slip_ratio(rolling.along)
    driving, skidding = ca.fmin(ca.fmax(slip, 0.0), 1.0), ca.fmin(slip, 0.0)
    h = ca.fmax(sinkage / wheel.radius, _LEAST_SINKAGE)
    entry = ca.acos(ca.fmax(1.0 - h, 0.0))
    n = soil.exponent + soil.exponent_by_slip * driving - soil.exponent_by_skid * skidding
    return _Contact(
        radius=wheel.radius,
        entry=entry,
        leave=-ca.acos(ca.fmax(1.0 - soil.exit_ratio * h, 0.0)),
        crest=(soil.crest_at_rest + soil.crest_by_slip * driving) * entry,
        transition=entry * (1.0 + 0.5 * skidding),
        stiffness=_stiffness(wheel, soil, n),
        exponent=n,
    )


def _stiffness(wheel: Wheel, soil: Soil, n: Num) -> Num:
    r, b = wheel.radius, wheel.width
    if soil.pressure_law == "bekker":
        return (soil.k_c / b + soil.k_phi) * r**n
    return (soil.cohesion * soil.k_c + soil.density * soil.k_phi * b) * (r / b) ** n


def _stressed(soil: Soil, contact: _Contact) -> Iterator[tuple[Num, Num, Num]]:
    """Quadrature points of the rim: angle [rad], weight [rad] and pressure [Pa]; rear zone, then front zone.

    Behind its crest the pressure has the profile of the front zone, stretched over the angle of the rear zone.
    """
    places, weights = np.polynomial.legendre.leggauss(_POINTS)
    for end in (contact.leave, contact.entry):
        for place, weight in zip(places.tolist(), weights.tolist(), strict=True):
            share = 0.5 * (1.0 + place)  # 0 at the crest, 1 at the end
            theta = contact.crest + share * (end - contact.crest)
            in_front = contact.crest + share * (contact.entry - contact.crest)
            rise = ca.fmax(ca.cos(in_front) - ca.cos(contact.entry), 1e-12)
            yield theta, 0.5 * weight * ca.fabs(end - contact.crest), contact.stiffness * rise**contact.exponent


def _shear_moduli(soil: Soil, side_slip: Num) -> tuple[Num, Num]:
    beta = ca.fmin(side_slip, _LARGEST_SIDE_SLIP)
    k_x = soil.shear_x + (soil.shear_x_by_angle + soil.shear_x_by_angle_squared * beta) * beta
    return k_x, soil.shear_y + soil.shear_y_by_angle * beta


def _sheared_along(contact: _Contact, theta: Num, rolling: Rolling) -> Num:
    """Backward shear displacement of the soil at theta [m].

    In front of the transition it starts and ends at 0; without skid the transition is at the entry.
    """
    f, t = contact.entry, contact.transition
    front = (ca.sin(f) - ca.sin(t)) * (f - theta) / ca.fmax(f - t, 1e-9) - (ca.sin(f) - ca.sin(theta))
    rear = t - theta - rolling.along * (ca.sin(t) - ca.sin(theta))
    return contact.radius * ca.if_else(theta > t, rolling.along * front, rear)


def _mobilised(soil: Soil, j_x: Num, j_y: Num, rolling: Rolling, theta: Num) -> tuple[Num, Num]:
    """Mobilised shares of the shear strength along and across [-], from displacements over their moduli.

    ``separate`` (Ishigami): each share can reach 1. ``combined`` (Pavlov & Johnson): the length of both displacements
    counts, and the shear has the direction in which the rim slides.
    """
    if soil.shear_law == "separate":
        return _share(j_x), _share(j_y)
    slide_x, slide_y = ca.fabs(1.0 - rolling.along * ca.cos(theta)), ca.fabs(rolling.across)
    total = _share(ca.sqrt(j_x**2 + j_y**2)) / ca.sqrt(slide_x**2 + slide_y**2 + 1e-18)
    return _direction(j_x) * slide_x * total, _direction(j_y) * slide_y * total


def _direction(j: Num) -> Num:
    """Smoothed sign of a displacement over its modulus."""
    return j / ca.sqrt(j**2 + _TURNING**2)


def _share(j: Num) -> Num:
    """Mobilised share of the strength, with the sign of the displacement over its modulus."""
    return ca.sign(j) * (1.0 - ca.exp(-ca.fabs(j)))


def _bulldozing(soil: Soil, depth: Num) -> Num:
    """Bulldozing force per length of the wheel's side [N/m], after Hegedus."""
    phi = soil.friction_angle
    cot = 1.0 / ca.tan(math.pi / 4.0 - 0.5 * phi)
    D_1 = cot + ca.tan(math.pi / 4.0 + 0.5 * phi)
    D_2 = cot + cot**2 * ca.tan(phi)
    return D_1 * (soil.cohesion * depth + 0.5 * D_2 * soil.density * GRAVITY * depth**2)
