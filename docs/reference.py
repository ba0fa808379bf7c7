"""Sphinx extension: writes the pages of the reference from the code before each build; formulas as MathML."""

import ast
import inspect
import textwrap
from collections.abc import Iterable, Iterator
from itertools import groupby
from pathlib import Path
from typing import Any, Final

import click
import gymnasium
import typer
from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from pydantic import BaseModel

import offtrack
from offtrack.commands.cli import app as command_line
from offtrack.reports.sections import groups
from scenarios.part_listing import KINDS, Key, keys, parts
from sensors.render import RendererUnavailableError
from vehicle.combination.description import Vehicle
from vehicle.combination.unit import AxleBrake
from vehicle.foundation.quantity import Option, tables_in
from vehicle.rover.description import Rover, Soil, _FourWheels
from vehicle.tyres.laws import TYRES
from vehicle.tyres.property_file import TyreFileOptions

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


NO_DATA: Final = (
    "origin_x",
    "lifted_axles",
    "exposed",
    "has_torque_inputs",
    "has_failing_brakes",
)  # fields that no file has
TABLES: Final = {  # page: head of a file's part, and its table
    "Vehicle files": (("", Vehicle), ("axle_brakes.NAME", AxleBrake)),
    "Tyres": (*(("tyres.NAME", tyre) for tyre in TYRES.values()), ("tyres.NAME", TyreFileOptions)),
    "Rover files": (("", Rover), ("", _FourWheels)),
    "Soil files": (("", Soil),),
}
MEANINGS: Final = {  # of keys that need no comment beside the code
    "name": "Name, of letters, digits, _ and -",
    "summary": "What it is, in a line",
    "model": "Law of the tyre's force",
    "tyre": "Name of a table of tyres",
    "axles": "The axles",
    "mass": "Mass",
    "cg_x": "Position of the centre of gravity",
    "cg_height": "Height of the centre of gravity above the ground",
    "width": "Width",
    "x": "Position",
    "track": "Distance between the centres of the wheels",
    "steered": "True: the wheels are steered",
    "driven": "True: the wheels are driven",
    "wheel_radius": "Radius of a loaded wheel",
    "hitch_height": "Height of the rear hitch above the ground",
    "roll_axis_height": "Height of the roll axis under the centre of gravity",
    "pitch_frequency": "Of the pitching body, undamped",
    "limit_deg": "Largest angle to either side",
    "rate_limit_deg": "Largest rate of the angle",
    "steer_limit_deg": "Largest angle of a wheel to either side",
    "steer_rate_limit_deg": "Largest rate of a wheel's angle",
    "steer_lag": "First-order time constant of the steering",
    "max_acceleration": "Largest acceleration",
    "traction_control": "True: the drive torque is limited where driven wheels spin",
    "traction_slip": "Slip at which traction control limits the torque",
    "drag_area": "Drag coefficient times frontal area",
    "density": "Density of the air",
    "abs": "True: axles with a modulator have ABS",
    "relaxation_length": "Distance over which the force follows the slip",
    "roll_centre_height": "Height of the roll centre above the ground",
    "roll_stiffness": "Of the coupling in roll, pressed together",
    "lash_deg": "Angle between separation and the kingpin's catch",
    "area": "Area of the side",
    "pressure_law": "Pressure over sinkage",
    "k_c": "Modulus of cohesion",
    "k_phi": "Modulus of friction",
    "shear_x_by_angle_squared": "Increase of k_x with the square of the slip angle",
    "shear_y_by_angle": "Increase of k_y with the slip angle",
    "initial_slope": "Force over load and slip at small slip",
    "peak_slip": "Slip of the largest force",
    "peak_force": "Largest force over load",
    "sliding_slip": "Slip from which on the tyre slides",
    "sliding_force": "Force of the sliding tyre over load",
}


def comments(model: type[BaseModel]) -> dict[str, str]:
    """Comments of a table's fields: behind a field, or above it."""
    found: dict[str, str] = {}
    for base in reversed(model.__mro__):
        if not base.__module__.startswith("vehicle."):
            continue
        lines = textwrap.dedent(inspect.getsource(base)).splitlines()
        (body,) = (node.body for node in ast.parse("\n".join(lines)).body if isinstance(node, ast.ClassDef))
        for node in body:
            if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.end_lineno:
                behind = lines[node.end_lineno - 1][node.end_col_offset :].partition("#")[2]
                above = lines[node.lineno - 2].strip()
                text = behind or (above if above.startswith("#") else "")
                found[node.target.id] = text.strip("# ").replace("``", "`")
    return found


def file_tables(model: type[BaseModel], place: str = "") -> Iterator[tuple[str, type[BaseModel], list[Key]]]:
    """Head, class and keys of a table of a file, then of the tables in it."""
    said, listed, inner = comments(model), [], []
    for name, field in model.model_fields.items():
        if name in NO_DATA:
            continue
        tables = [] if name == "tyre" else tables_in(field.annotation)  # a file names a table of tyres
        one = Option.of(name, field)
        meaning = said.get(name) or one.meaning or MEANINGS.get(name, "")
        if tables:
            is_list = one.kind is tuple
            head = f"{place.strip('[]')}{'.' * bool(place)}{name}"
            meaning = meaning or (inspect.getdoc(tables[0]) or "").partition("\n")[0].rstrip(".")
            inner += [(f"[{head}]" if is_list else head, table) for table in tables if name != "rear_steering"]
        kind = "list of tables" if tables and one.kind is tuple else "table" if tables else ""
        span = kind or ", ".join(one.choices) or one.range or {bool: "true, false", str: "text"}.get(one.kind, "")
        usual = "none" if one.default is None and not field.is_required() else one.default
        usual = "required" if field.is_required() else str(usual).lower() if isinstance(usual, bool) else usual
        meaning = meaning.replace("None: ", "if not given: ")
        text = meaning[:1].upper() + meaning[1:] + (f". Limits: {one.why}" if one.why else "")
        listed.append(Key(name=name, default=f"{usual}" or '""', unit=one.unit, range=span, meaning=text))
    yield place, model, listed
    for head, table in inner:
        yield from file_tables(table, head)


def vehicles_page() -> Iterator[str]:
    """Keys of the files of vehicles, tyres, rovers and soils. A number may be ``{ value = …, source = "…" }``."""
    for title, tables in TABLES.items():
        yield f"## {title}\n"
        for head, model in tables:
            for place, one, listed in file_tables(model, head):
                said = (inspect.getdoc(one) or "").partition("\n")[0]
                yield f"**{code(f'[{place}]') if place else 'Top level'}** {said}\n"
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
        try:
            result = offtrack.run(scenario, settings=settings)
        except RendererUnavailableError as error:
            yield f"Made without cameras, whose signals lack here: {error}.\n"
            result = offtrack.run(scenario, settings={**settings, "off_tracking": "surrogate"})
        signals = {signal.name: signal for signal in result.log.signals}
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


PAGES: Final = (
    keys_page,
    vehicles_page,
    parts_page,
    signals_page,
    summary_page,
    environments_page,
    commands_page,
    python_page,
)


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
