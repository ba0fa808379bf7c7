"""Optional packages, which are installed with an extra of offtrack."""

import importlib.util


def check_extra(extra: str, what: str, *packages: str) -> None:
    """Check that packages of an extra are installed; ``what`` begins the line, such as ``MCAP needs``.

    Raises:
        ValueError: one line that says how to install it.
    """
    if any(importlib.util.find_spec(package) is None for package in packages):
        raise ValueError(f"{what} the extra '{extra}': pip install 'offtrack[{extra}]'")
