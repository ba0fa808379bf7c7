"""Formats that finished runs are written in, by name. A new format is one class and one line here.

Names of signals may have any letters, spaces and hyphens, as units' names have. Formats that take less write
``plain_names``, and the original name beside each.
"""

import re
import unicodedata
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import ClassVar, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from scenarios.catalogue import Catalogue
from scenarios.progress import Progress, no_progress
from scenarios.results.log import Log
from vehicle.foundation.user_file import nearest

EXPORT: Final = Catalogue(
    {
        "csv": "offtrack.exchange.exports.tables:Csv",
        "xlsx": "offtrack.exchange.exports.tables:Xlsx",
        "mat": "offtrack.exchange.exports.tables:Mat",
        "mf4": "offtrack.exchange.exports.tables:Mf4",
        "mcap": "offtrack.exchange.exports.mcap_file:Mcap",
        "rosbag2": "offtrack.exchange.exports.rosbag2:Rosbag2",
    },
    methods=("write",),
    declares=("file", "takes_images"),
)
TIME: Final = "time"  # signal that every format writes


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportedRun:
    """A finished run to write."""

    log: Log  # signals to write
    scenario: Path
    whole: Log | None = None  # all signals, by which bodies move; None: those to write
    images: Path | None = None  # the recording that the same run made
    decimal: str = "."  # mark in numbers that are text
    progress: Progress = no_progress

    @property
    def motion(self) -> Log:
        """The log with the signals of all bodies."""
        return self.log if self.whole is None else self.whole


class ExportFormat(Protocol):
    """A format of signals with their units and meanings."""

    file: ClassVar[str]  # name of the file or folder, in the run's directory if no other is given
    takes_images: ClassVar[bool]

    @staticmethod
    def write(run: ExportedRun, path: Path) -> tuple[Path, ...]:
        """Write a run; return the files. The same run gives the same bytes.

        Raises:
            ValueError: one line, if a file exists, a package is missing, or the run does not fit the format.
        """


def chosen_signals(log: Log, patterns: str) -> Log:
    """The log of the time and of the signals that fit patterns, with commas between them: ``off_tracking*,steer*``.

    Raises:
        ValueError: one line, if a pattern fits none.
    """
    chosen = {TIME}
    for pattern in filter(None, (part.strip() for part in patterns.split(","))):
        found = [name for name in log.names if fnmatchcase(name, pattern)]
        if not found:
            listed = "offtrack export RUN --list shows all"
            raise ValueError(f"--signals {pattern}: no signal has such a name{nearest(pattern, log.names)}; {listed}")
        chosen.update(found)
    return Log.of((signal, log[signal.name]) for signal in log.signals if signal.name in chosen)


def by_rows(log: Log) -> list[tuple[NDArray[np.bool_], tuple[str, ...]]]:
    """Rows (n,) in which signals have values, each with the names of these signals; all rows for those without any."""
    groups: dict[bytes, tuple[NDArray[np.bool_], list[str]]] = {}
    for name in (name for name in log.names if name != TIME):
        known = ~np.isnan(log[name])
        rows = known if known.any() else ~known
        groups.setdefault(rows.tobytes(), (rows, []))[1].append(name)
    return [(rows, tuple(names)) for rows, names in groups.values()]


_OTHER: Final = re.compile(r"[^A-Za-z0-9]+")


def plain_names(names: Iterable[str], longest: int = 200, case: Callable[[str], str] = str) -> dict[str, str]:
    """Names of ASCII letters, digits and single underscores that begin with a letter, by the original names.

    Accents are dropped and other letters become their code point; equal ones are numbered. Plain names stay as they
    are, but for what ``case`` makes of them.
    """
    plain = {name: case(_plain(name, longest)) for name in names}
    taken = {name for name in plain if plain[name] == name}
    for name in (name for name in plain if plain[name] != name):
        count, first = 1, plain[name]
        while plain[name] in taken:
            count += 1
            plain[name] = f"{first[: longest - len(str(count)) - 1]}_{count}"
        taken.add(plain[name])
    return plain


def _plain(name: str, longest: int) -> str:
    letters = (one for one in unicodedata.normalize("NFKD", name) if not unicodedata.combining(one))
    text = _OTHER.sub("_", "".join(one if one.isascii() else f"_u{ord(one):x}_" for one in letters)).strip("_")
    return (text if text[:1].isalpha() else f"s_{text}")[:longest].rstrip("_")
