"""Options of the simulated vehicle's brakes."""

from __future__ import annotations

from scenarios.options.base import Options, option


class BrakeOptions(Options):
    """Electronic systems of brakes and drive; those not given are as in the vehicle file."""

    abs: bool | None = option("Anti-lock braking; not given: as in the vehicle file.", None)
    traction_control: bool | None = option(
        "Traction control of the driven wheels; not given: as in the vehicle file.", None
    )
