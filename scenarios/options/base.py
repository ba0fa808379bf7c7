"""What the tables of a scenario are declared with: fields of numbers and of words, and texts that name files."""

from typing import Annotated

import tomli_w
from pydantic import AfterValidator, BeforeValidator

from vehicle.foundation.quantity import Frozen, option, quantity
from vehicle.foundation.user_file import full_path

__all__ = ["FullPath", "PartName", "ScenarioTable", "Word", "one_word", "option", "quantity"]

FullPath = Annotated[str, AfterValidator(full_path)]  # a saved scenario runs anywhere


def one_word(value: object) -> object:
    """An id or a name as a text, where TOML or ``--set`` gave a number."""
    return str(value) if isinstance(value, int | float) and not isinstance(value, bool) else value


Word = Annotated[str | None, BeforeValidator(one_word)]


def _with_full_path(name: str) -> str:
    return full_path(name) if name.endswith(".fmu") else name


PartName = Annotated[str, AfterValidator(_with_full_path)]  # of the catalogue, package.module:Name, or an FMU's file


class ScenarioTable(Frozen):
    """Base of scenarios: the resolved table as a file."""

    def to_toml(self) -> str:
        """The resolved scenario as TOML: it runs again identically."""
        return tomli_w.dumps(self.model_dump(exclude_none=True))
