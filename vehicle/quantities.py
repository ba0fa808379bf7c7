"""Types of numbers with unit and limits, for the models of the parameter files."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field


def quantity(
    unit: str, *, ge: float | None = None, gt: float | None = None, le: float, meaning: str | None = None
) -> Any:
    """Pydantic field of a number: its limits, the unit that error messages name, and a line about its meaning."""
    extra: dict[str, Any] = {"unit": unit}
    return Field(ge=ge, gt=gt, le=le, strict=True, allow_inf_nan=False, json_schema_extra=extra, description=meaning)


# Limits from a hand cart to the largest road train: they catch errors of unit and sign.
Mass = Annotated[float, quantity("kg", gt=0.0, le=2e5)]
Inertia = Annotated[float, quantity("kg m2", gt=0.0, le=1e7)]
Position = Annotated[float, quantity("m", ge=-40.0, le=40.0)]
Length = Annotated[float, quantity("m", gt=0.0, le=10.0)]
Fraction = Annotated[float, quantity("-", ge=0.0, le=1.0)]
Flag = Annotated[bool, Field(strict=True)]
Lag = Annotated[float, quantity("s", gt=0.0, le=5.0)]
Gradient = Annotated[float, quantity("rad/(m/s2)", gt=0.0, le=0.1)]
Frequency = Annotated[
    float, quantity("Hz", gt=0.0, le=5.0)
]  # undamped; a higher one is too stiff for an explicit step of 1 ms


class Frozen(BaseModel):
    """Immutable, validated model that accepts no unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid")
