"""Parameters of an FMU as options of a part."""

from __future__ import annotations

import math

from scenarios.fmi_import.archive import FmuFile
from vehicle.option import Option


def options_of(fmu: FmuFile) -> tuple[Option, ...]:
    """Options for the numeric parameters of an FMU whose names are plain words; a map can set the others too."""
    return tuple(
        Option(
            name,
            None,
            " ".join(one.meaning.split()) or "parameter of the FMU",
            one.unit or "-",
            -math.inf if one.low is None else one.low,
            math.inf if one.high is None else one.high,
            default_text=one.start or "0",
        )
        for name, one in fmu.variables.items()
        if one.causality == "parameter" and one.is_number and name.isidentifier()
    )
