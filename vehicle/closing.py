"""End of a part: what it holds beyond memory, such as the process of an FMU, is freed."""

from __future__ import annotations

import logging
from typing import Protocol, runtime_checkable

_LOG = logging.getLogger(__name__)


@runtime_checkable
class Closes(Protocol):
    """A part that holds a process, a file or a connection. A part that wraps others closes them."""

    def close(self) -> None:
        """Free it; nothing is asked of the part afterwards. A second call does nothing."""


def close_part(part: object) -> None:
    """Close a part if it is one of those that must be; an error of a user's own part is a warning, the run is done."""
    if not isinstance(part, Closes):
        return
    try:
        part.close()
    except Exception as error:  # of a user's class: of any kind
        _LOG.warning("offtrack: %s.close() raised %s: %s", type(part).__name__, type(error).__name__, error)
