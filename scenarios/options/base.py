"""What all tables of a scenario file have in common."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field


def quantity(default: float | None, unit: str, *, ge: float, le: float) -> Any:
    """A number with its default, limits and unit."""
    return Field(default, ge=ge, le=le, json_schema_extra={"unit": unit})


class Options(BaseModel):
    """A checked table that cannot be changed and knows no other keys than its own."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
