"""Tables of pandas, which is installed only if somebody wants them."""

from __future__ import annotations

import importlib
from typing import Any


def pandas() -> Any:
    """The module pandas.

    Raises:
        ImportError: one line, if it is not installed.
    """
    try:
        return importlib.import_module("pandas")
    except ImportError:
        raise ImportError("to_pandas needs pandas: pip install 'offtrack[pandas]'") from None
