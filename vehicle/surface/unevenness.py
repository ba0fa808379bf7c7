"""Road unevenness as power spectral densities: the classes of ISO 8608, for isotropic roads.

A track along a road has the displacement density Gd(n) = Gd(n0) (n/n0)^-2 over the spatial frequency n [cycles/m]. If
the road is as uneven in any other direction (isotropic), its density over the plane, S(k) with k^2 = nx^2 + ny^2,
follows: the track's one-sided density is 2 times the integral of S over all ny, and with S = c k^-3

    2 * integral of c (n^2 + ny^2)^(-3/2) d ny = 4 c n^-2,   hence   c = Gd(n0) n0^2 / 4.

A tyre averages over its contact patch, nearly as a Gaussian of standard deviation s: the density becomes
Gd(n) exp(-q^2) with q = 2 pi s n. The isotropic density with such tracks is its Abel inversion,

    S = c k^-3 (erfc(q) + 2 q exp(-q^2) / sqrt(pi))   with   q = 2 pi s k.

Two tracks d apart then have the cross density Gd(n) * X K1(X) with X = 2 pi n d, which is real: they are equal for
long waves (X -> 0 gives 1) and independent for short ones, which makes a vehicle roll.
"""

from __future__ import annotations

from types import MappingProxyType

import numpy as np
from scipy.special import erfc, k1

from vehicle.frames import FloatArray

REFERENCE = 0.1  # n0 of ISO 8608 [cycles/m]
# Gd(n0) [m3]: geometric means of the classes of ISO 8608, each four times the one before
ROAD_CLASSES = MappingProxyType({name: 16e-6 * 4.0**i for i, name in enumerate("ABCDEFGH")})


def displacement_psd(road_class: str, n: FloatArray) -> FloatArray:
    """One-sided density Gd [m3] of a track's height at the spatial frequencies n [cycles/m].

    Raises:
        ValueError: if there is no such class.
    """
    if road_class not in ROAD_CLASSES:
        raise ValueError(f"road class = '{road_class}' must be one of {', '.join(ROAD_CLASSES)} (ISO 8608)")
    return np.asarray(ROAD_CLASSES[road_class] * (n / REFERENCE) ** -2, dtype=np.float64)


def felt_psd(road_class: str, n: FloatArray, spread: float) -> FloatArray:
    """Density Gd [m3] after averaging by a tyre with a standard deviation of ``spread`` [m]."""
    return displacement_psd(road_class, n) * np.exp(-((2.0 * np.pi * spread * n) ** 2))


def plane_psd(road_class: str, k: FloatArray, spread: float) -> FloatArray:
    """Two-sided density [m4] over the plane of spatial frequencies of modulus k > 0 [cycles/m], for ``felt_psd``."""
    q = 2.0 * np.pi * spread * k
    averaged = erfc(q) + 2.0 * q * np.exp(-(q**2)) / np.sqrt(np.pi)
    return np.asarray(displacement_psd(road_class, k) / (4.0 * k) * averaged, dtype=np.float64)


def coherence(n: FloatArray, apart: float) -> FloatArray:
    """Cross density of two parallel tracks ``apart`` [m] from each other over the density of one of them."""
    X = 2.0 * np.pi * n * apart
    return np.asarray(X * k1(X), dtype=np.float64)
