"""Options of the simulated vehicle: differences from the data sheet that controllers know."""

from __future__ import annotations

from typing import Any

from pydantic import ConfigDict

from scenarios.options.base import FullPath, option
from vehicle.combination.plant_changes import NamedChanges


class PlantOptions(NamedChanges):
    """Changes of the simulated vehicle: named ones, or any number of the vehicle file by its path."""

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False, strict=True)

    kind: str | None = option("multibody, constant_slip or package.module:Name; not given: as the course needs.", None)
    fmu: FullPath | None = option("FMU that simulates the vehicle; the scenario's vehicle stays its data sheet.", None)

    def changes(self) -> dict[str, Any]:
        """Changes of the vehicle that are not at their defaults."""
        fields = type(self).model_fields
        values = {name: value for name, value in self if name not in ("kind", "fmu")}
        return {name: value for name, value in values.items() if name not in fields or value != fields[name].default}
