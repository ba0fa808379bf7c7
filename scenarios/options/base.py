"""Base class and field helpers of all tables of a scenario file."""

from __future__ import annotations

from typing import Annotated, Any, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from vehicle.user_file import full_path


def quantity(default: float | None, unit: str, low: float, high: float, meaning: str) -> Any:
    """A number with its default, unit, limits and meaning."""
    return Field(default, ge=low, le=high, description=meaning, json_schema_extra={"unit": unit})


def option(meaning: str, default: Any = ...) -> Any:
    """A value with its meaning; required if it has no default."""
    return Field(default, description=meaning)


FullPath = Annotated[str, AfterValidator(full_path)]  # a saved scenario runs anywhere


class Options(BaseModel):
    """Base class of tables: frozen, validated, unknown keys refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def tables_in(annotation: object) -> tuple[type[BaseModel], ...]:
    """All tables in a field's annotation: alone, in a list or as alternatives."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return (annotation,)
    return tuple(table for part in get_args(annotation) for table in tables_in(part))
