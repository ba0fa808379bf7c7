"""Calls of an FMU's library that every step needs; by FMPy's classes they cost three times as much."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import Any, Final

KINDS: Final = ("Real", "Float64")
_STATUS: Final = ("ok", "warning", "discard", "error", "fatal", "pending")
_FAILED: Final = 2  # the least status of a failure


def setter(fmu: Any, version: int, references: Sequence[int]) -> Callable[[bytes], None]:
    """Function that sets floating-point variables from doubles."""
    call, values = _transfer(fmu, "Set", version, references)
    size = ctypes.sizeof(values)

    def set_values(content: bytes) -> None:
        ctypes.memmove(values, content, size)
        call()

    return set_values


def getter(fmu: Any, version: int, references: Sequence[int]) -> Callable[[], bytes]:
    """Function that gets floating-point variables as doubles."""
    call, values = _transfer(fmu, "Get", version, references)
    size = ctypes.sizeof(values)

    def get_values() -> bytes:
        call()
        return ctypes.string_at(values, size)

    return get_values


def stepper(fmu: Any, version: int) -> Callable[[float, float], None]:
    """Function that does a step from a time over a length [s]."""
    instance = ctypes.c_void_p(fmu.component)
    if version == 2:
        function = _function(fmu, "fmi2DoStep", (ctypes.c_double, ctypes.c_double, ctypes.c_int))
        return lambda time, length: _check("fmi2DoStep", function(instance, time, length, 1))
    flags = [ctypes.c_bool() for _ in range(3)]  # event needed, terminate, returned early
    reached = ctypes.c_double()
    pointers = [*map(ctypes.byref, flags), ctypes.byref(reached)]
    kinds = (ctypes.c_double, ctypes.c_double, ctypes.c_bool, *(ctypes.c_void_p,) * 4)
    function = _function(fmu, "fmi3DoStep", kinds)

    def step(time: float, length: float) -> None:
        _check("fmi3DoStep", function(instance, time, length, True, *pointers))
        if flags[1]:
            raise RuntimeError("it asks to end the simulation")

    return step


def _transfer(fmu: Any, way: str, version: int, references: Sequence[int]) -> tuple[Callable[[], None], Any]:
    """Function that moves values between the FMU and an array, and the array."""
    count = len(references)
    instance, places = ctypes.c_void_p(fmu.component), (ctypes.c_uint * count)(*references)
    values = (ctypes.c_double * count)()
    name = f"fmi{version}{way}{'Real' if version == 2 else 'Float64'}"
    kinds = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p, ctypes.c_size_t)
    function = _function(fmu, name, kinds[: 3 if version == 2 else 4])
    arguments = (instance, places, count, values) if version == 2 else (instance, places, count, values, count)
    return lambda: _check(name, function(*arguments)), values


def _function(fmu: Any, name: str, kinds: Sequence[type]) -> Any:
    address = ctypes.cast(getattr(fmu.dll, name), ctypes.c_void_p).value
    return ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, *kinds)(address or 0)


def _check(name: str, status: int) -> None:
    if status >= _FAILED:
        meaning = _STATUS[status] if status < len(_STATUS) else "unknown"
        raise RuntimeError(f"{name} failed with status {status} ({meaning})")
