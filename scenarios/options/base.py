"""Base class and field helpers of all tables of a scenario file."""

from __future__ import annotations

from typing import Annotated, Any, get_args

import tomli_w
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from vehicle.foundation.user_file import full_path


def quantity(default: float | None, unit: str, low: float, high: float, meaning: str) -> Any:
    """A number with its default, unit, limits and meaning."""
    return Field(default, ge=low, le=high, description=meaning, json_schema_extra={"unit": unit})


def option(meaning: str, default: Any = ...) -> Any:
    """A value with its meaning; required if it has no default."""
    return Field(default, description=meaning)


FullPath = Annotated[str, AfterValidator(full_path)]  # a saved scenario runs anywhere


def _with_full_path(name: str) -> str:
    return full_path(name) if name.endswith(".fmu") else name


PartName = Annotated[str, AfterValidator(_with_full_path)]  # of the catalogue, package.module:Name, or an FMU's file


class Options(BaseModel):
    """Base class of tables: frozen, validated, unknown keys refused; a boolean or a text is no number."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)

    @model_validator(mode="before")
    @classmethod
    def _with_tuples(cls, table: Any) -> Any:
        """The table of a file with tuples in place of its lists."""
        return {key: _as_tuple(value) for key, value in table.items()} if isinstance(table, dict) else table

    def to_toml(self) -> str:
        """The resolved table as TOML: as a scenario, it runs again identically."""
        return tomli_w.dumps(self.model_dump(exclude_none=True))


def _as_tuple(value: Any) -> Any:
    return tuple(map(_as_tuple, value)) if isinstance(value, list) else value


def tables_in(annotation: object) -> tuple[type[BaseModel], ...]:
    """All tables in a field's annotation: alone, in a list or as alternatives."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return (annotation,)
    return tuple(table for part in get_args(annotation) for table in tables_in(part))
