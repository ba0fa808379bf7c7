"""`offtrack view`: finished runs in one page that plays them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scenarios.commands.console import Quiet, one_line_errors

EXAMPLES = (
    "Examples: offtrack view runs/roundabout-1 runs/roundabout-2   offtrack view runs/roundabout-1   "
    "offtrack view runs/rover-slope-1 runs/rover-slope-2 --out slopes.html"
)
_LONGEST_NAME = 100


def view(
    runs: Annotated[list[Path], typer.Argument(help="Directories of finished runs, all of trailers or all of rovers.")],
    out: Annotated[
        Path | None, typer.Option(help="Name of the page; it is replaced.", show_default="runs/view-RUN-RUN.html")
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Lay finished runs over each other in one page: plan, 3-D view, charts, pictures, and a table of differences.

    The page moves all runs to the same time, or to the same distance driven. It needs no network and no other file.
    """
    with one_line_errors():
        from scenarios.results.files import replaced
        from scenarios.studies.finished_runs import names_of_runs, page_link
        from scenarios.viewing.finished import finished_run
        from scenarios.viewing.view_page import view_page

        names = names_of_runs(runs)
        page = out or Path("runs") / (f"view-{'-'.join(run.resolve().name for run in runs)}"[:_LONGEST_NAME] + ".html")
        if page.is_dir() or not (page.parent.is_dir() or out is None):
            raise ValueError(f"--out {page}: must be a file in an existing folder")
        finished = [finished_run(run, name) for run, name in zip(runs, names, strict=True)]
        links = [page_link(run, page.parent) for run in runs]
        text = view_page(finished, links)
        page.parent.mkdir(parents=True, exist_ok=True)
        replaced(page, text)
        if not quiet:
            typer.echo(f"Page: {page}")
