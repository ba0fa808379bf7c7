"""Compiled kernels of the odometries: C files of this folder, from the cache of compiled code."""

import ctypes
from collections.abc import Callable
from functools import cache
from importlib import resources
from typing import Any

import numpy as np

from vehicle.engine.compiler import Compiler, CompilerError, compiler, library


def kernel(file: str, name: str, definitions: tuple[str, ...] = ()) -> Callable[..., None] | None:
    """Function of a C file with macros defined; None without a compiler.

    Its arguments are integers, and contiguous arrays of the type that the C code expects.
    """
    return _loaded(file, name, definitions, compiler())


@cache
def _loaded(file: str, name: str, definitions: tuple[str, ...], using: Compiler | None) -> Callable[..., None] | None:
    if using is None:
        return None
    source = (resources.files("estimators.odometry") / file).read_text(encoding="utf-8")
    try:
        function = library(source, definitions, using)[name]
    except CompilerError:
        return None

    def call(*arguments: Any) -> None:
        function(*(_passed(argument) for argument in arguments))

    return call


def _passed(argument: Any) -> Any:
    return ctypes.c_void_p(argument.ctypes.data) if isinstance(argument, np.ndarray) else ctypes.c_long(argument)
