"""Numbers with a unit and limits, as the models behind the parameter files use them."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field


def quantity(
    unit: str, *, ge: float | None = None, gt: float | None = None, le: float, meaning: str | None = None
) -> Any:
    """Pydantic field of a number: its limits, the unit that error messages name, and a line about its meaning."""
    extra: dict[str, Any] = {"unit": unit}
    return Field(ge=ge, gt=gt, le=le, strict=True, allow_inf_nan=False, json_schema_extra=extra, description=meaning)


# The limits are those of road vehicles from a hand cart to the largest road train: they catch slips of unit and sign.
Mass = Annotated[float, quantity("kg", gt=0.0, le=2e5)]
Inertia = Annotated[float, quantity("kg m2", gt=0.0, le=1e7)]
Position = Annotated[float, quantity("m", ge=-40.0, le=40.0)]
Length = Annotated[float, quantity("m", gt=0.0, le=10.0)]
Fraction = Annotated[float, quantity("-", ge=0.0, le=1.0)]
Flag = Annotated[bool, Field(strict=True)]
Lag = Annotated[float, quantity("s", gt=0.0, le=5.0)]
Gradient = Annotated[float, quantity("rad/(m/s2)", gt=0.0, le=0.1)]
Frequency = Annotated[float, quantity("Hz", gt=0.0, le=5.0)]  # undamped; stiffer is beyond a 1 ms explicit step's care


class Frozen(BaseModel):
    """A checked value that cannot be changed and knows no other keys than its own."""

    model_config = ConfigDict(frozen=True, extra="forbid")
