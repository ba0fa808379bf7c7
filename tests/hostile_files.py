"""Files that no command may hang on, run out of memory on, or end in a traceback on."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Final

SPARSE = 3_000_000_000  # size of a file without content [bytes]


def _sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(SPARSE)


HOSTILE: Final[dict[str, Callable[[Path], object]]] = {
    "pipe": os.mkfifo,
    "endless device": lambda path: path.symlink_to("/dev/zero"),
    "empty device": lambda path: path.symlink_to("/dev/null"),
    "folder": Path.mkdir,
    "circle of links": lambda path: path.symlink_to(path.name),
    "sparse": _sparse,
    "empty": lambda path: path.write_bytes(b""),
    "random bytes": lambda path: path.write_bytes(bytes((7 * k * k + 13 * k) % 256 for k in range(5000))),
    "not UTF-8": lambda path: path.write_bytes("Größe = 1, é\n".encode("latin-1")),
    "null characters": lambda path: path.write_bytes(b"\0" * 1000),
}
