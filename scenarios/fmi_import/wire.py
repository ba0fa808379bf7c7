"""Requests to the process of an FMU, and its answers.

A request is one byte: ``STEP`` is followed by time, length and inputs as doubles, ``SET_STATE`` by a size and as many
bytes. An answer is one byte, a size and as many bytes: outputs as doubles, a state, or the text of a failure.
"""

from __future__ import annotations

import struct
from typing import Final, Protocol

STEP: Final = b"s"
STATE: Final = b"g"
SET_STATE: Final = b"r"
END: Final = b"q"
DONE: Final = b"+"
FAILED: Final = b"-"
SIZE: Final = struct.Struct("=I")
HEAD: Final = 1 + SIZE.size  # of an answer [bytes]


class Writer(Protocol):
    """Anything that takes bytes."""

    def write(self, data: bytes, /) -> object:
        """Write all of them."""


def answer(out: Writer, content: bytes) -> None:
    """Answer with content."""
    out.write(DONE + SIZE.pack(len(content)) + content)


def refuse(out: Writer, error: Exception) -> None:
    """Answer with a failure."""
    text = f"{type(error).__name__}: {error}".encode(errors="replace")
    out.write(FAILED + SIZE.pack(len(text)) + text)
