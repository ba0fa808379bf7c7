"""Set-up of all tests, before numpy is loaded: for this process, pytest's workers and all that they start."""

import gc
import os
import sys
from pathlib import Path
from typing import Any, Final

import pytest
from hypothesis import settings

pytest_plugins = ["tests.runs"]  # fixtures of finished runs and worlds

_ORACLES: Final = Path(__file__).parent / "oracles"
_MAY_BE_MISSING: Final = ("Wine", "is not on this machine")  # no package of it for every processor; interpreters


def pytest_addoption(parser: pytest.Parser) -> None:
    """An option for the gate: what is skipped there is never run anywhere."""
    parser.addoption(
        "--no-skips", action="store_true", help="a skipped test fails, except where Wine or an interpreter is missing"
    )


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Comparisons with other programs, and pages in a browser, need what only ``make test-all`` installs."""
    for item in items:
        if item.path.is_relative_to(_ORACLES) or "browser" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.slow)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Any:
    """Fail skipped tests with ``--no-skips``."""
    return _unskipped(item.config, (yield))


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector: pytest.Collector) -> Any:
    """Fail skipped modules with ``--no-skips``."""
    return _unskipped(collector.config, (yield))


def _unskipped(config: pytest.Config, report: Any) -> Any:
    excused = any(missing in str(report.longrepr) for missing in _MAY_BE_MISSING)
    if config.getoption("--no-skips") and report.skipped and not excused:
        report.outcome = "failed"
    return report


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
