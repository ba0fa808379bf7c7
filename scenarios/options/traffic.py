"""Options of moving traffic: ``traffic = "following"``, or a table."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator

from scenarios.options.base import Options, option, quantity


class TrafficOptions(Options):
    """Vehicles that move around the trailer in its cameras' view."""

    kind: Literal["none", "following", "overtaking", "crossing", "mixed"] = option(
        "Traffic around the trailer; mixed: one vehicle of each kind.", "none"
    )
    gap: float = quantity(3.8, "m", 2.0, 50.0, "Distance from the trailer's rear to a following vehicle, +- 0.4 m.")


def _table(traffic: Any) -> Any:
    return {"kind": traffic} if isinstance(traffic, str) else traffic


TrafficTable = Annotated[TrafficOptions, BeforeValidator(_table)]
