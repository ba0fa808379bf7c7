"""Parameters of a replaceable part: a table of them, or options that the part declares.

A part of one's own declares ``options``, a tuple of `Option`, and takes their values by keyword. A part of the
repository has a nested class ``Parameters``, a table whose fields carry default, unit, limits, tuning range and
meaning; its constructor takes the table as ``parameters``. The two forms meet in `declared_options` and `arguments`.
"""

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, Self

from pydantic import ValidationError

from vehicle.foundation.quantity import Frozen, Option, Parameter, complaint, option, quantity
from vehicle.foundation.user_file import nearest, shown

COMBINATION: Final = "combination"  # keyword of a law's constructor for the data sheet of the whole combination
__all__ = [
    "COMBINATION",
    "Option",
    "Parameter",
    "PartParameters",
    "arguments",
    "check_options",
    "declared_options",
    "option",
    "option_values",
    "quantity",
]


class PartParameters(Frozen):
    """Base of the parameters of a part."""

    @classmethod
    def of(cls, given: Mapping[str, object], prefix: str = "") -> Self:
        """The parameters with the given values, and defaults for the others.

        Raises:
            ValueError: one line that names ``prefix.name`` of the first unknown parameter, or of the first wrong value
                with its limits and unit.
        """
        try:
            return cls.model_validate(dict(given))
        except ValidationError as error:
            raise ValueError(complaint(cls, error, prefix)) from None

    @classmethod
    def option(cls, name: str) -> Option:
        """The declaration of one parameter."""
        return Option.of(name, cls.model_fields[name])


def check_options(options: Sequence[Option], given: Mapping[str, Parameter], prefix: str = "") -> None:
    """Check that the given values belong to options and keep their limits.

    Args:
        options: of one part.
        given: values by name.
        prefix: of the names in messages: ``prefix.name``; empty: the name alone.

    Raises:
        ValueError: one line that names the first unknown option, or the first wrong value with its limits and unit.
    """
    known = {option.name: option for option in options}
    for name, value in given.items():
        key = f"{prefix}.{name}" if prefix else name
        if name not in known:
            raise ValueError(f"unknown key '{shown(key)}'{nearest(name, tuple(known))}")
        known[name].check(value, key)


def option_values(options: Sequence[Option], given: Mapping[str, Parameter], prefix: str) -> dict[str, Parameter]:
    """Values of all options: the given ones, and the others' defaults; those without either are left out.

    Raises:
        ValueError: as `check_options`.
    """
    check_options(options, given, prefix)
    defaults = {option.name: option.default for option in options if option.default is not None}
    return {**defaults, **given}


def declared_options(part: Callable[..., object], *, or_keywords: bool = False) -> tuple[Option, ...]:
    """Options of a part's class, by its ``options`` or its ``Parameters``.

    With ``or_keywords`` the keywords of the constructor are the options of a class that declares none.
    """
    declared, table = getattr(part, "options", None), _table(part)
    if isinstance(declared, tuple | list):
        return tuple(declared)
    if table is not None:
        return tuple(map(table.option, table.model_fields))
    if not or_keywords or hasattr(part, "of"):  # ``of`` reads options from its context
        return ()
    keywords = [
        p for p in inspect.signature(part).parameters.values() if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)
    ]
    return tuple(_undeclared(keyword) for keyword in keywords[1:] if keyword.name != COMBINATION)


def arguments(part: Callable[..., object], given: Mapping[str, Parameter], prefix: str) -> dict[str, Any]:
    """Keyword arguments that a part is constructed by, from values of its options, which are checked.

    Raises:
        ValueError: as `check_options`.
    """
    table = _table(part)
    if table is not None and "parameters" in inspect.signature(part).parameters:
        return {"parameters": table.of(given, prefix)}
    check_options(declared_options(part, or_keywords=True), given, prefix)
    return dict(given)


def _table(part: object) -> type[PartParameters] | None:
    table = getattr(part, "Parameters", part)  # or it is a table itself
    return table if inspect.isclass(table) and issubclass(table, PartParameters) else None


def _undeclared(keyword: inspect.Parameter) -> Option:
    """Option that any value is accepted for."""
    default = keyword.default
    if isinstance(default, int | float) and not isinstance(default, bool):
        return Option(keyword.name, float(default), "")
    text = "required" if default is keyword.empty else repr(default)
    return Option(keyword.name, None, "", type_without_default=object, default_text=text)
