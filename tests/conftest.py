"""Set-up of all tests."""

from __future__ import annotations

import os
import sys


def pytest_configure() -> None:
    """Let Python keep compiled modules: workers and commands, some hundred processes, import the same ones."""
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.dont_write_bytecode = False
