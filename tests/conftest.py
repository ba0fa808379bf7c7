"""Set-up of all tests, before numpy is loaded: for this process, pytest's workers and all that they start."""

from __future__ import annotations

import gc
import os
import sys

from hypothesis import settings


def pytest_configure() -> None:
    """Keep compiled modules, and let no process of many use several cores for small matrices.

    Some hundred processes import the same modules. Threads of OpenBLAS wait actively: with them the driver's design,
    27 Riccati equations of 7 states, takes sixteen times the processor time while others are at work.
    """
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.dont_write_bytecode = False
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    settings.register_profile("offtrack", deadline=None)  # no test is timed: a busy machine is no defect
    settings.load_profile("offtrack")


def pytest_collection_finish() -> None:
    """Let the garbage collector pass over what stays for good: half a million objects of modules and of tests."""
    gc.collect()
    gc.freeze()
