"""Sphinx extension: writes the pages of the reference from the code before each build; formulas as MathML."""

import inspect
from collections.abc import Iterable, Iterator
from itertools import groupby
from pathlib import Path
from typing import Any, Final

import click
import gymnasium
import typer
from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml

import offtrack
from offtrack.commands.cli import app as command_line
from offtrack.reports.sections import groups
from scenarios.part_listing import KINDS, Key, keys, parts

FOLDER: Final = Path(__file__).parent / "reference"  # ignored by git
MODULES: Final = (  # what users import, or derive their own parts from
    *("offtrack", "controllers.trailer", "controllers.driver", "estimators.estimates", "estimators.context"),
    *("sensors.messages", "sensors.context", "sensors.faults.fault"),
    *("vehicle.option", "vehicle.clock", "vehicle.combination.truth"),
)
TINY: Final = {"course.length": 20, "rig.width": 128, "rig.height": 64}
RUNS: Final = {  # short ones that have all signals
    "trailer": ("constant-slip", {**TINY, "rig.self_calibration": True, "faults": "dropout:0.1"}),
    "rover": ("rover-slope", {"slip_estimator": "truth", "course.length": 1}),
}


def table(head: str, rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table; bars in cells are escaped."""
    names = head.split(", ")
    lines = [names, ["---"] * len(names), *rows]
    return "\n".join("| " + " | ".join(str(c).replace("|", r"\|") for c in line) + " |" for line in lines) + "\n"


def code(text: object) -> str:
    """Text in the type of code; nothing of nothing."""
    return f"`{text}`" if str(text) else ""


def default(value: object) -> str:
    """What an option is where it is not given; empty for flags and what has no default."""
    return code(value) if isinstance(value, str | int | float) and not isinstance(value, bool) else ""


def cells(key: Key) -> tuple[str, ...]:
    """Name, default, unit, range and meaning."""
    return code(key.name), code(key.default), key.unit, key.range, key.meaning


def keys_page() -> Iterator[str]:
    """What ``--set`` and scenario files may contain, by tables."""
    for kind, scenario in (("trailer", None), ("rover", "rover-slope")):
        yield f"## Keys of a {kind}'s scenario\n"
        for name, listed in groupby(keys(scenario), lambda key: key.name.rpartition(".")[0].partition(".")[0]):
            yield f"**{code(name) or 'Top level'}**\n"
            yield table("key, default, unit, range, meaning", map(cells, listed))


def parts_page() -> Iterator[str]:
    """What can be replaced, by kind, with parameters."""
    for kind in KINDS:
        yield f"## {code(kind)}\n"
        yield table("name, meaning", ((code(part.name), part.meaning) for part in parts(kind)))
        rows = [(code(part.name), *cells(key)) for part in parts(kind) for key in part.parameters]
        yield table("part, parameter, default, unit, range, meaning", rows) if rows else ""


def signals_page() -> Iterator[str]:
    """Columns of ``signals.parquet`` in short runs; those of the trailer without its name."""
    for kind, (scenario, settings) in RUNS.items():
        signals = {signal.name: signal for signal in offtrack.run(scenario, settings=settings).log.signals}
        copies = {f"{name}_semitrailer" for name in signals}
        own = (signal for name, signal in signals.items() if name not in copies)
        yield f"## Signals of a {kind}'s run\n"
        yield table("signal, unit, meaning", ((code(s.name), s.unit, s.description) for s in own))


def summary_page() -> Iterator[str]:
    """Numbers of ``summary.json``, by group."""
    for name, group in groups().items():
        yield f"## {code(name)}: {group.title}\n"
        rows = ((code(key), number.own_unit, number.label, number.meaning) for key, number in group.numbers.items())
        yield table("number, unit, label, meaning", rows)


def environments_page() -> Iterator[str]:
    """Observations of the environments, in order."""
    for name in ("TrailerSteering-v0", "TractorTrailerDriving-v0", "RoverSteering-v0"):
        environment: Any = gymnasium.make(f"offtrack/{name}").unwrapped
        rows = ((code(feature.name), feature.unit, f"± {feature.limit:g}") for feature in environment.core.features)
        yield f"## {code(name)}\n\n" + table("observation, unit, limit", rows)


def commands_page(context: click.Context | None = None) -> Iterator[str]:
    """Arguments, options and examples of the commands."""
    context = context or click.Context(typer.main.get_command(command_line), info_name="offtrack")
    command: Any = context.command
    if hasattr(command, "commands"):
        for name in command.list_commands(context):
            yield from commands_page(click.Context(command.commands[name], parent=context, info_name=name))
        return
    usage, text = " ".join(command.collect_usage_pieces(context)), inspect.cleandoc(command.help).replace("\b\n", "")
    yield f"## {code(context.command_path)}\n\n`{context.command_path} {usage}`\n\n{text}\n"
    rows = ((code(", ".join([*p.opts, *p.secondary_opts])), default(p.default), p.help or "") for p in command.params)
    yield table("argument or option, default, meaning", rows)
    yield f"```text\n{inspect.cleandoc(command.epilog)}\n```\n" if command.epilog else ""


def python_page() -> Iterator[str]:
    """What users import, or derive their own parts from."""
    return (f"## {code(module)}\n\n```{{eval-rst}}\n.. automodule:: {module}\n```\n" for module in MODULES)


PAGES: Final = (keys_page, parts_page, signals_page, summary_page, environments_page, commands_page, python_page)


def write(_: object) -> None:
    """Write all pages; one that is as it was keeps its time, so that Sphinx does not read it again."""
    FOLDER.mkdir(exist_ok=True)
    for page in PAGES:
        name = page.__name__.removesuffix("_page")
        file, text = FOLDER / f"{name}.md", f"# {name.capitalize()}\n\n{page.__doc__}\n\n" + "\n".join(page())
        if not file.exists() or file.read_text("utf-8") != text:
            file.write_text(text, "utf-8")


def lead_in(app: Any, error: object) -> None:
    """Write a first page that leads to the root of the site."""
    if error is None and app.builder.name == "html":
        line = f'<meta http-equiv="refresh" content="0; url={app.config.root_doc}.html">'
        (Path(app.outdir) / "index.html").write_text(f"<!doctype html>\n{line}\n", "utf-8")


def formula(translator: Any, node: nodes.math | nodes.math_block) -> None:
    """Write a formula, in a line or on its own."""
    translator.body.append(tex2mathml(node.astext(), as_block=isinstance(node, nodes.math_block)))
    raise nodes.SkipNode


def setup(app: Any) -> None:
    """Register the pages and the formulas."""
    app.connect("builder-inited", write)
    app.connect("build-finished", lead_in)
    app.add_html_math_renderer("mathml", (formula, None), (formula, None))
