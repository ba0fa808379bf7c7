"""Compiled kernels of the odometries: C files of this folder, from the cache of compiled code."""

import ctypes
from collections.abc import Callable
from functools import cache
from importlib import resources
from typing import Any

import numpy as np

from vehicle.engine.compiler import Compiler, CompilerError, compiler, library


def kernel(file: str, name: str, definitions: tuple[str, ...] = ()) -> Callable[..., Any] | None:
    """Function of a C file with macros defined, of integers and contiguous arrays; None without a compiler."""
    return _loaded(file, name, definitions, compiler())


@cache
def _loaded(file: str, name: str, definitions: tuple[str, ...], using: Compiler | None) -> Callable[..., Any] | None:
    source = (resources.files("estimators.odometry") / file).read_text(encoding="utf-8")
    try:
        function = using and library(source, definitions, using)[name]
    except CompilerError:
        return None
    return function and (lambda *arguments: function(*map(_passed, arguments)))


def _passed(argument: Any) -> Any:
    return ctypes.c_void_p(argument.ctypes.data) if isinstance(argument, np.ndarray) else ctypes.c_long(argument)
