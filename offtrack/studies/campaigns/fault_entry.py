"""Faults of a campaign in its TOML file: kinds, amounts and times, and the searches for the smallest that fails."""

import itertools
import re
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Final, Literal, NamedTuple

from pydantic import Field, TypeAdapter, ValidationError, field_validator, model_validator

from scenarios.catalogue import FAULT, resolve
from scenarios.options.tables import FaultOptions, Faults
from vehicle.foundation.quantity import Frozen
from vehicle.option import Option

NONE: Final = "none"  # name of the reference, which has no fault
END: Final = "end"  # duration of a fault that lasts to the end of the run
_NAME: Final = re.compile(r"[\w.-]+")
_LONGEST: Final = 500  # values in a list
_FAULTS: Final = TypeAdapter(Faults)


class FaultTime(NamedTuple):
    """When a fault acts."""

    onset: float  # [s]
    end: float | None  # [s]; None: to the end of the run


class FaultEntry(Frozen):
    """One table ``[[fault]]``. Each list may be a distribution instead, as ``{uniform = [0.1, 0.9]}``."""

    kind: str
    name: str = ""  # in tables and figures; empty: the kind
    amounts: Any = ()  # numbers, or lists of numbers for kinds that have several; empty: the kind's defaults
    onsets: Any = (0.0,)  # [s]
    durations: Any = (END,)  # [s]
    also: str = ""  # kind and amount of a second fault at the same time, as "gyro_drift:2"; empty: none
    seeds: tuple[Annotated[int, Field(ge=0, strict=True)], ...] = ()  # empty: all of the campaign
    only: dict[str, Any] = Field(default_factory=dict)  # values of the axes with which it runs; others: all

    @field_validator("amounts", "onsets", "durations")
    @classmethod
    def _listed(cls, values: Any) -> Any:
        if isinstance(values, Mapping):
            return values
        if not isinstance(values, tuple) or len(values) > _LONGEST or len(set(map(str, values))) < len(values):
            raise ValueError("must be a list of different values, or a distribution such as {uniform = [0.1, 0.9]}")
        return values

    @property
    def title(self) -> str:
        """Its name in tables and figures."""
        return self.name or self.kind

    def options(self) -> tuple[Option, ...]:
        """Numbers of its kind."""
        return tuple(resolve("kind", self.kind, FAULT).options)

    def texts(self) -> tuple[str, ...]:
        """The fault with every combination of its lists, as ``faults=`` takes it; drawn numbers are words in braces.

        Raises:
            ValueError: one line, for a value that the kind does not take.
        """
        texts = tuple(
            "; ".join(f"{fault}@{onset}{d and f'+{d}'}" for fault in (self.kind + (a and f":{a}"), self.also) if fault)
            for a, onset, d in itertools.product(self._amounts(), self._times("onset"), self._times("duration"))
        )
        for text in texts:
            if "{" not in text:
                fault_options(text)
        return texts

    def text_with(self, values: Mapping[str, tuple[float, ...]]) -> str:
        """The fault with these amounts, onsets or durations; of each other list the first value.

        Raises:
            ValueError: one line, if a value that it needs is drawn, or the kind does not take it.
        """
        (text, *_) = self.model_copy(update=dict(values)).texts()
        if "{" in text:
            raise ValueError(f"fault {self.title}: onset or duration is drawn: give the search its own")
        return text

    def drawn(self) -> Iterator[tuple[str, Any]]:
        """Dotted keys and numbers of the distributions, as the table ``draw`` of a study has them."""
        for key in ("amount", "onset", "duration"):
            values = getattr(self, f"{key}s")
            if isinstance(values, Mapping):
                for kind, numbers in values.items():
                    yield f"{{{self.title}.{key}}}.{kind}", numbers

    def check(self) -> None:
        """Check the name.

        Raises:
            ValueError: one line.
        """
        if not _NAME.fullmatch(self.name or "x") or self.title == NONE:
            raise ValueError(f"fault {self.title}: a name consists of letters, digits, dots, _ and -, and is not none")

    def _amounts(self) -> list[str]:
        if isinstance(self.amounts, Mapping):
            return [f"{{{self.title}.amount:.6g}}"]
        numbers = [amount if isinstance(amount, tuple) else (amount,) for amount in self.amounts]
        return [",".join(map(_number, amount)) for amount in numbers] or [""]

    def _times(self, key: str) -> list[str]:
        values = getattr(self, f"{key}s")
        if isinstance(values, Mapping):
            return [f"{{{self.title}.{key}:.3f}}"]
        return ["" if value == END else _number(value) for value in values] or ["0"]


class Pairs(Frozen):
    """The table ``[pairs]``: every pair of these faults, both at the same time."""

    faults: tuple[str, ...] = Field(min_length=2)  # kinds with their amount, if any, as "gyro_drift:2"
    onsets: Any = (0.0,)  # [s]
    durations: Any = (END,)  # [s]

    def entries(self) -> tuple[FaultEntry, ...]:
        """An entry for every pair, named after both kinds."""
        return tuple(self._entry(*pair) for pair in itertools.combinations(self.faults, 2))

    def _entry(self, one: str, other: str) -> FaultEntry:
        kind, _, amount = one.partition(":")
        return FaultEntry(
            kind=kind,
            name=f"{kind}-{other.partition(':')[0]}",
            amounts=(tuple(amount.split(",")),) if amount else (),
            onsets=self.onsets,
            durations=self.durations,
            also=other,
        )


def _number(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


def fault_options(text: str) -> tuple[FaultOptions, ...]:
    """Faults of a text as ``faults=`` takes it.

    Raises:
        ValueError: one line.
    """
    try:
        return _FAULTS.validate_python(text)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        message = str(first["msg"]).removeprefix("Value error, ").replace("Input should be", "must be")
        where = ".".join(map(str, first["loc"][1:]))
        raise ValueError(f"fault {text}: {where}{where and ' '}{message}") from None


def fault_time(text: str) -> FaultTime | None:
    """When the faults of a text act, from the first onset to the last end; None: there is none."""
    faults = fault_options(text)
    if not faults:
        return None
    ends = [None if fault.duration is None else fault.start + fault.duration for fault in faults]
    known = [end for end in ends if end is not None]
    return FaultTime(min(fault.start for fault in faults), max(known) if len(known) == len(ends) else None)


Number = Literal["amount", "duration"]
_FINEST = 1e-4  # tolerance, as a share of the range


class Bisect(Frozen):
    """One search, made for each law, further axis and seed; other lists of the fault have their first value."""

    fault: str  # title of an entry
    of: Number = "amount"  # its first number; a kind with several keeps the others
    low: float
    high: float
    onset: float | None = None  # [s]; not given: the first of the entry
    duration: float | None = None  # [s]; not given: the first of the entry
    tolerance: Annotated[float, Field(gt=0.0)]  # width of the interval that holds the smallest value that fails
    seeds: tuple[Annotated[int, Field(ge=0, strict=True)], ...] = ()  # empty: those of the entry
    only: dict[str, Any] = Field(default_factory=dict)  # values of the axes; others: all

    @model_validator(mode="after")
    def _possible(self) -> "Bisect":
        if not self.low < self.high:
            raise ValueError(f"low = {self.low:g} must be below high = {self.high:g}")
        if self.tolerance < _FINEST * (self.high - self.low):
            raise ValueError(f"tolerance = {self.tolerance:g} must be at least {_FINEST:g} of the range")
        return self

    def text_of(self, entry: FaultEntry, value: float) -> str:
        """The fault with this value, as ``faults=`` takes it.

        Raises:
            ValueError: one line, if the kind does not take it.
        """
        given = {"amounts": None, "onsets": self.onset, "durations": self.duration} | {f"{self.of}s": value}
        return entry.text_with({key: (number,) for key, number in given.items() if number is not None})
