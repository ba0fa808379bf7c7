"""Options of the simulated vehicle's brakes."""

from __future__ import annotations

from scenarios.options.base import Options, option


class BrakeOptions(Options):
    """Electronic systems of the brakes; those not given are as in the vehicle file."""

    abs: bool | None = option("Anti-lock braking; not given: as in the vehicle file.", None)

    def changes(self) -> dict[str, bool]:
        """Changes of the vehicle's table ``brakes``."""
        return {name: value for name, value in self if value is not None}
