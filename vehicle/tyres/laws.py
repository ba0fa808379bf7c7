"""Catalogue of the tyre laws, by the name that a table ``[tyres.name]`` gives as its ``model``."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from vehicle.tyres.brush import BrushTyre
from vehicle.tyres.linear import LinearTyre
from vehicle.tyres.magic_formula import MagicFormulaTyre
from vehicle.tyres.tmeasy import TmeasyTyre
from vehicle.tyres.tyre import Tyre

TYRES: Final[Mapping[str, type[Tyre]]] = MappingProxyType(
    {
        "linear": LinearTyre,
        "brush": BrushTyre,
        "magic_formula": MagicFormulaTyre,
        "tmeasy": TmeasyTyre,
    }
)
