"""Functions composed of calls of other functions, and the cache of derived CasADi functions.

A processor calls a short list of operations twice in less time than it takes for one of twice the length: the short
one stays in its cache for instructions.

The key of a function holds all that decides on it: what it is, the description that it is derived from, the sources of
this package, and the versions of CasADi, numpy and Python.
"""

import platform
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

import casadi as ca
import numpy as np
from pydantic import BaseModel

from vehicle.foundation.user_cache import kept, sources_hash


class Call(NamedTuple):
    """Call of a ``casadi.Function`` (state, input, numbers, *results of earlier calls) -> result.

    CasADi's machine calls one of SX, and writes one of MX, on whole vectors, out at its place.
    """

    function: Any
    state: int = 0  # 0: that of the whole; k: the first entries of the result of call k, counted from 1
    results: tuple[int, ...] = ()  # the calls whose results it takes
    needed: int | None = None  # number of the first entries of its result that are needed; None: all


class Composite(NamedTuple):
    """Function (state, input, numbers) -> result of the last call."""

    name: str
    calls: tuple[Call, ...]

    def numel_in(self, argument: int) -> int:
        """Length of an argument."""
        return int(self.calls[0].function.numel_in(argument))

    def on(self, x: Any, u: Any, *numbers: Any) -> Any:
        """Expression of the result; of SX with the calls written out, of MX with the calls in it."""
        values = [x]
        for call in self.calls:
            state = values[call.state][: call.function.numel_in(0)]
            arguments = [state, u, *numbers, *(values[k] for k in call.results)]
            values.append(
                _first(call.function.call(arguments, call.function.is_a("MXFunction"), False)[0], call.needed)
            )
        return values[-1]

    def of_functions(self, changed: Callable[[Any], Any]) -> "Composite":
        """The composite of changed functions; each is changed once."""
        new = {call.function: changed(call.function) for call in self.calls}
        return self._replace(calls=tuple(call._replace(function=new[call.function]) for call in self.calls))

    def shortened(self) -> "Composite":
        """The composite with functions that compute only the needed entries."""
        return self._replace(calls=tuple(call._replace(function=_shortened(call)) for call in self.calls))


def _shortened(call: Call) -> Any:
    function = call.function
    if call.needed is None:
        return function
    arguments = [ca.SX.sym("v", function.numel_in(k)) for k in range(function.n_in())]
    return ca.Function(function.name(), arguments, [function(*arguments)[: call.needed]])


def _first(value: Any, n: int | None) -> Any:
    return value if n is None else value[:n]


AnyFunction: TypeAlias = "Composite | Any"  # or a ``casadi.Function`` (state, input, numbers) -> result


def composite(function: AnyFunction) -> Composite:
    """The function as a composite, of one call if it is none."""
    return function if isinstance(function, Composite) else Composite(function.name(), (Call(function),))


def written_out(function: AnyFunction) -> Any:
    """The function as one ``casadi.Function`` of SX, with all calls written out."""
    if not isinstance(function, Composite):
        return function
    x, u, numbers = (ca.SX.sym("v", function.numel_in(k)) for k in range(3))
    return ca.Function(function.name, [x, u, numbers], [ca.cse(function.on(x, u, numbers))])


_PACKAGE: Final = Path(__file__).parents[1]
SOURCES: Final = sources_hash(_PACKAGE)  # while they are imported, so that it is theirs even if they are edited later
VERSIONS: Final = (ca.CasadiMeta.version(), np.__version__, platform.python_version(), platform.machine())


def derived_once(name: str, described: tuple[BaseModel | None, ...], derive: Callable[[], AnyFunction]) -> AnyFunction:
    """The function ``name`` of the descriptions: from the cache, or derived and then cached.

    Descriptions whose classes are not of this package are not cached, as their sources may change.
    """
    if not SOURCES or any(_is_foreign(model) for model in described):
        return derive()
    text = "\0".join([name, *map(repr, described), SOURCES, *VERSIONS])
    return kept(text.encode(), derive)


def _is_foreign(part: object) -> bool:
    return any(not of.__module__.startswith(f"{_PACKAGE.name}.") for of in _classes(part))


def _classes(part: object) -> Iterator[type]:
    """Classes of the models in a description."""
    if isinstance(part, BaseModel):
        yield type(part)
        for _, value in part:
            yield from _classes(value)
    elif isinstance(part, tuple):
        for value in part:
            yield from _classes(value)
