"""Optional packages, which are installed with an extra of offtrack."""

import importlib
import importlib.util
from typing import Any


def check_extra(extra: str, what: str, *packages: str) -> None:
    """Check that packages of an extra are installed; ``what`` begins the line, such as ``MCAP needs``.

    Raises:
        ValueError: one line that says how to install it.
    """
    missing = [one for one in packages if importlib.util.find_spec(one.partition(".")[0]) is None]
    if missing:
        lacks = f" ({', '.join(missing)} is missing)" if missing != list(packages) else ""
        raise ValueError(f"{what} the extra '{extra}'{lacks}: {installation(extra)}")


def installation(extra: str) -> str:
    """Command that installs an extra; PyTorch for processors is on an index of its own."""
    index = " --extra-index-url https://download.pytorch.org/whl/cpu" if extra == "rl" else ""
    return f"pip install 'offtrack[{extra}]'{index}"


def import_extra(extra: str, what: str, *modules: str) -> Any:
    """Import modules of an extra and return the first; ``what`` begins the line of a refusal.

    Raises:
        ValueError: one line that says how to install it.
    """
    check_extra(extra, what, *modules)
    first, *_ = [importlib.import_module(module) for module in modules]
    return first
