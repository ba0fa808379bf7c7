"""Report pages as data, rendered by templates into self-contained HTML files.

The templates escape all text. Only a :class:`Figure` holds markup, and only its template marks markup as safe.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, Literal, NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined

from offtrack.reports.player.encoding import EncodedPlayback, explorer_script, player_script, player_style

Kind = Literal["name", "number", "text", "note"]  # row title, right-aligned, plain, in a soft colour
Emphasis = Literal["", "best", "good", "bad", "soft"]


class Cell(NamedTuple):
    """A table cell with more than plain text."""

    text: str
    emphasis: Emphasis = ""
    colour: str = ""  # CSS colour of a square in front of the text
    share: float | None = None  # length of a bar behind the text, 0 … 1
    link: str = ""  # address that the text leads to


Row = Sequence[str | Cell]  # a row of one cell is the title of the rows below it


class Column(NamedTuple):
    """A table column: how its cells look, and its title."""

    kind: Kind
    title: str = ""


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of cells; the head is left out if no column has a title."""

    columns: Sequence[Column]
    rows: Sequence[Row]
    kind: ClassVar = "table"

    def cells(self, row: Row) -> list[tuple[Column, Cell]]:
        """Cells of a row with their columns."""
        plain = [cell if isinstance(cell, Cell) else Cell(cell) for cell in row]
        return list(zip(self.columns, plain, strict=True))


class Shade(NamedTuple):
    """A field of a matrix: a short text on a colour that stands for a share."""

    text: str
    share: float  # 0 … 1
    meaning: str  # shown when the pointer is on it
    link: str = ""  # address that the text leads to


@dataclass(frozen=True, slots=True)
class Matrix:
    """Shares as colours, from the paper's to a strong one, with their numbers; columns are in groups."""

    groups: Sequence[tuple[str, Sequence[str]]]  # title and columns of each
    rows: Sequence[tuple[str, Sequence[Shade | None]]]  # title and fields of each; None: nothing is known
    meaning: str  # of the colour
    kind: ClassVar = "matrix"


@dataclass(frozen=True, slots=True)
class Figure:
    """A drawing as the text of SVG elements; made by :mod:`offtrack.reports.plots` only."""

    svg: str  # one for a wide page, and one for a phone
    title: str = ""
    kind: ClassVar = "figure"


@dataclass(frozen=True, slots=True)
class Items:
    """A list of short texts, with bullets or with numbers."""

    items: Sequence[str]
    numbered: bool = False
    kind: ClassVar = "items"


@dataclass(frozen=True, slots=True)
class Preformatted:
    """Text shown as it is, such as a file."""

    text: str
    kind: ClassVar = "preformatted"


@dataclass(frozen=True, slots=True)
class Player:
    """A playback with slider, views and charts; one on a page. It is the only content that needs JavaScript."""

    encoded: EncodedPlayback
    live: str = ""  # address of the server of a run that goes on
    kind: ClassVar = "player"

    @property
    def script(self) -> str:
        """The code that plays it."""
        return player_script()


class ExplorerAxis(NamedTuple):
    """A varied key or a number of the runs of a study."""

    label: str
    unit: str = ""
    digits: int = 3
    words: bool = False  # its values are words
    varied: bool = False


class ExplorerRun(NamedTuple):
    """A run of a study with a value for each axis."""

    name: str
    outcome: str
    good: bool
    values: Sequence[str | float | None]
    link: str = ""  # address of its page


@dataclass(frozen=True, slots=True)
class Explorer:
    """Runs over parallel axes and as dots over two of them; a click opens a run's page. One on a page."""

    axes: Sequence[ExplorerAxis]
    runs: Sequence[ExplorerRun]
    kind: ClassVar = "explorer"

    @property
    def table(self) -> str:
        """Axes and runs as JSON."""
        table = {"axes": [axis._asdict() for axis in self.axes], "runs": [run._asdict() for run in self.runs]}
        return json.dumps(table, separators=(",", ":"), allow_nan=False)

    @property
    def script(self) -> str:
        """The code that draws it."""
        return explorer_script()


Content = Table | Matrix | Figure | Items | Preformatted | Player | Explorer


class Verdict(NamedTuple):
    """A short result next to a heading, green if good, else red."""

    text: str
    good: bool


def outcome_verdict(outcome: str) -> Verdict:
    """The outcome of a run; only "completed" is good."""
    return Verdict(outcome, outcome == "completed")


class Card(NamedTuple):
    """One of the main numbers, shown large."""

    value: str
    unit: str
    label: str
    note: str  # time and place, or the meaning


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a page: heading, a few sentences, and contents."""

    title: str
    text: str = ""
    content: Sequence[Content] = ()
    verdict: Verdict | None = None
    collapsed: bool = False  # shows its title only, until clicked


@dataclass(frozen=True, slots=True, kw_only=True)
class Page:
    """A whole report."""

    title: str  # of the browser's tab
    heading: str = ""  # the title, if empty
    subtitle: str
    changes: str = ""  # keys that are not those of the shipped scenario
    verdict: Verdict | None = None
    answer: Sequence[str] = ()  # what the page says, in a sentence or a few
    cards: Sequence[Card] = ()
    sections: Sequence[Section]
    wide: bool = True  # for wide tables

    @property
    def player_style(self) -> str:
        """Style sheet of the contents that are played or explored; empty on a page without any."""
        contents = (content for section in self.sections for content in section.content)
        return player_style() if any(isinstance(content, Player | Explorer) for content in contents) else ""

    def html(self) -> str:
        """The page as one HTML file that loads nothing else."""
        return _environment().get_template("page.html.j2").render(page=self)


def some(texts: Sequence[str], most: int) -> list[str]:
    """The first texts, and how many more there are."""
    return [*texts[:most], *([f"and {len(texts) - most} more"] if len(texts) > most else [])]


def software_section(versions: Mapping[str, str]) -> Section:
    """Names and versions of the software behind a page."""
    return Section("Software", ", ".join(f"{name} {version}" for name, version in versions.items()))


def facts_table(facts: Mapping[str, str]) -> Table:
    """Names and values, one pair a row."""
    return Table((Column("name"), Column("text")), list(facts.items()))


@lru_cache(maxsize=1)
def _environment() -> Environment:
    loader = PackageLoader("offtrack.reports")
    return Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
