"""Loose soil as data: the contents of its file, checked, and the source of each number."""

from __future__ import annotations

import math
from typing import Annotated, Final, Literal

from vehicle.parameter_file import checked, read_toml, without_sources
from vehicle.parameter_library import ParameterLibrary
from vehicle.quantities import Fraction, Frozen, quantity

_Modulus = Annotated[float, quantity("m", gt=0.0, le=0.5)]
_Change = Annotated[float, quantity("m/rad", ge=-0.5, le=0.5)]

_SOILS: Final = ParameterLibrary("soil", "soils")


class Soil(Frozen):
    """Soil under a rigid wheel: strength, pressure over sinkage, and shear.

    The pressure at a sinkage z under a wheel of width b is, by ``pressure_law``, Bekker's (k_c / b + k_phi) z^n or
    Reece's (c k_c + rho k_phi b) (z / b)^n. Reece's k_phi is multiplied by the mass density, as in the files of the
    Tohoku group: with the specific weight in its place the soil would be 9.8 times too stiff.
    """

    name: str
    summary: str = ""
    pressure_law: Literal["bekker", "reece"]
    shear_law: Literal["separate", "combined"]  # mobilise the shear strength along and across separately, or together
    cohesion: Annotated[float, quantity("Pa", ge=0.0, le=1e5)]  # c
    friction_angle_deg: Annotated[float, quantity("deg", gt=0.0, le=55.0)]  # phi
    density: Annotated[float, quantity("kg/m3", gt=0.0, le=5000.0)]  # rho
    exponent: Annotated[float, quantity("-", gt=0.0, le=3.0)]  # n
    exponent_by_slip: Annotated[float, quantity("-", ge=0.0, le=2.0)]  # increase of n for a slip ratio of 1
    exponent_by_skid: Annotated[float, quantity("-", ge=0.0, le=2.0)]  # increase of n for a slip ratio of -1
    k_c: Annotated[float, quantity("Pa m^(1-n) (bekker), - (reece)", ge=0.0, le=1e9)]
    k_phi: Annotated[float, quantity("Pa/m^n (bekker), m2/s2 (reece)", ge=0.0, le=1e9)]
    crest_at_rest: Fraction  # a_0: angle of the largest pressure over the entry angle, without slip
    crest_by_slip: Annotated[float, quantity("-", ge=0.0, le=1.0)]  # a_1: increase of a_0 for a slip ratio of 1
    exit_ratio: Annotated[float, quantity("-", ge=0.0, le=2.0)]  # lambda: exit height over sinkage
    shear_x: _Modulus  # k_x without side slip
    shear_x_by_angle: _Change  # increase of k_x with the slip angle
    shear_x_by_angle_squared: Annotated[float, quantity("m/rad2", ge=-0.5, le=0.5)]
    shear_y: _Modulus  # k_y without side slip
    shear_y_by_angle: _Change

    @property
    def friction_angle(self) -> float:
        """Angle of internal friction [rad]."""
        return math.pi / 180.0 * self.friction_angle_deg


def soil_names() -> tuple[str, ...]:
    """Names of the shipped soils."""
    return _SOILS.names()


def load_soil(name_or_path: str) -> Soil:
    """Load a shipped soil by its name, or one from a ``.toml`` file.

    Raises:
        ValueError: one line naming file, key, value, limit and unit, or the nearest known name.
    """
    path = _SOILS.file(name_or_path)
    return checked(Soil, without_sources(read_toml(path)), str(path))
