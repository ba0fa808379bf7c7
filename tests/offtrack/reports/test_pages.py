"""Pages escape the text they are given: names, descriptions, outcomes, error texts, files.

All of them are put together from the same kinds of content.
"""

import re
from html import escape
from pathlib import Path
from typing import Final

import numpy as np
import pytest

from offtrack.reports.page import (
    Bar,
    Card,
    Cell,
    Column,
    Content,
    Items,
    Page,
    Photo,
    Photos,
    Preformatted,
    Section,
    Stroke,
    Table,
    Verdict,
)
from offtrack.reports.player.encoding import explorer_script, player_script
from offtrack.reports.plots import drawn
from offtrack.reports.run_page import report_html
from scenarios.results.trailer_result import RunResult

BAD: Final = "<script>alert('$x^')</script>"  # a tag, quotes, and mathematics that matplotlib can not parse


TEMPLATES: Final = Path(__file__).resolve().parents[3] / "offtrack" / "reports" / "templates"


@pytest.mark.slow
def test_a_run_page_shows_the_image_where_the_off_tracking_was_largest(camera_run: RunResult) -> None:
    """The caption states the time of the image; they were taken at 10 Hz."""
    worst = camera_run.log["time"][np.nanargmax(np.abs(camera_run.signal("off_tracking_true")))]
    shown = re.search(
        r"Left camera at ([\d.]+) s, where the off-tracking was largest", report_html(camera_run, camera_run.summary())
    )
    assert shown is not None
    assert float(shown[1]) == pytest.approx(worst, abs=0.1)


@pytest.mark.parametrize(
    "content",
    [
        Table((Column("name", BAD), Column("number", BAD)), [[BAD], [BAD, Cell(BAD, colour=BAD, share=0.5)]]),
        Photos([Photo(b"", (1, 1), BAD, [Stroke((0.0, 0.0), (1.0, 1.0), BAD)])]),
        Bar([(BAD, 0.5)]),
        Items([BAD]),
        Items([BAD], numbered=True),
        Preformatted(BAD),
    ],
    ids=lambda content: content.kind,
)
def test_every_kind_of_content_is_escaped(content: Content) -> None:
    html = Page(
        title=BAD, heading=BAD, subtitle=BAD, verdict=Verdict(BAD, True), cards=[Card(BAD, BAD, BAD, BAD)],
        sections=[Section(BAD, BAD, [content], Verdict(BAD, False)), Section(BAD, content=[content], collapsed=True)],
    ).html()  # fmt: skip
    html = without_own_scripts(html)
    assert "<script" not in html
    assert "'$x^'" not in html
    assert escape(BAD, quote=False).replace("'", "&#39;") in html


def test_a_figure_keeps_its_lettering_as_text() -> None:
    """Labels are escaped by matplotlib, and their dollars are not read as mathematics."""
    with drawn("hostile") as (drawing, ax):
        ax.plot([0.0, 1.0], [0.0, 1.0], label=BAD)
        ax.set(xlabel=BAD, ylabel=BAD)
    assert "<script" not in drawing.content.svg
    assert drawing.content.svg.count(escape(BAD, quote=False)) == 3


def without_own_scripts(html: str) -> str:
    """A page without the script of the playback and its blocks of base64."""
    for script in (player_script(), explorer_script()):
        html = html.replace(f"<script>\n{script}\n</script>", "")
    return re.sub(r'<script type="text/plain" id="playback-\w+">[A-Za-z0-9+/=\n]*</script>', "", html)


def test_markup_is_marked_as_safe_in_one_place() -> None:
    """The SVG of a figure and the playback's own files, and nothing else, go into a page as they are."""
    templates = "".join(path.read_text(encoding="utf-8") for path in TEMPLATES.glob("*.j2"))
    safe = re.findall(r"\{\{ ([\w.]+) \| safe \}\}", templates)
    assert sorted(safe) == ["explorer.script", "figure.svg", "page.player_style", "player.script"]
    assert templates.count("safe") == 4
    assert "autoescape" not in templates
