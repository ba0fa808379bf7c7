"""Cache of CasADi functions: deriving the equations of a vehicle takes fifty times as long as reading them.

The key of a function holds all that decides on it: what it is, the description that it is derived from, the sources of
this package, and the versions of CasADi, numpy and Python.
"""

from __future__ import annotations

import hashlib
import json
import platform
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import casadi as ca
import numpy as np
from pydantic import BaseModel

from vehicle.engine.composite import AnyFunction, Call, Composite
from vehicle.engine.trusted_cache import cached, store

_PACKAGE: Final = Path(__file__).parents[1]


def _sources_hash() -> str:
    """Hash of the sources of this package; empty without sources."""
    found = hashlib.sha256()
    paths = sorted(_PACKAGE.rglob("*.py"))
    for path in paths:
        found.update(f"{path.relative_to(_PACKAGE)}\0".encode() + path.read_bytes())
    return found.hexdigest() if paths else ""


_SOURCES: Final = _sources_hash()  # while they are imported, so that it is theirs even if they are edited later
_VERSIONS: Final = (ca.CasadiMeta.version(), np.__version__, platform.python_version(), platform.machine())


def derived_once(name: str, described: tuple[BaseModel | None, ...], derive: Callable[[], AnyFunction]) -> AnyFunction:
    """The function ``name`` of the descriptions: from the cache, or derived and then cached.

    Descriptions whose classes are not of this package are not cached, as their sources may change.
    """
    if not _SOURCES or any(_is_foreign(model) for model in described):
        return derive()
    text = "\0".join([name, *map(repr, described), _SOURCES, *_VERSIONS])
    file = f"{hashlib.sha256(text.encode()).hexdigest()[:32]}.casadi"
    found = cached(file)
    if found is not None:
        return _read(found)
    function = derive()
    store(file, _written(function))
    return function


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


def _written(function: AnyFunction) -> bytes:
    if not isinstance(function, Composite):
        content: dict[str, Any] = {"functions": [function.serialize()]}
    else:
        functions = list(dict.fromkeys(call.function for call in function.calls))
        calls = [call._replace(function=functions.index(call.function)) for call in function.calls]
        content = {"functions": [of.serialize() for of in functions], "name": function.name, "calls": calls}
    return zlib.compress(json.dumps(content).encode(), level=1)


def _read(content: bytes) -> AnyFunction:
    read = json.loads(zlib.decompress(content))
    functions = [ca.Function.deserialize(of) for of in read["functions"]]
    if "calls" not in read:
        return functions[0]
    calls = (Call(functions[of], state, tuple(results), needed) for of, state, results, needed in read["calls"])
    return Composite(read["name"], tuple(calls))
