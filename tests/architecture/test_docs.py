"""The documents: links and pictures resolve, the README is short, and every command in them is one that would start."""

import ast
import importlib
import re
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest
import typer

import offtrack
from offtrack.commands.cli import app
from offtrack.studies.campaigns.campaign import campaign_names, load_campaign
from offtrack.studies.reproduce.reproduction import names_of
from offtrack.studies.study import load_study
from scenarios.catalogue import TRAILER_STEERING, Catalogue, resolve
from scenarios.options.scenario import load_any_scenario
from scenarios.options.shipped import scenario_names
from scenarios.part_listing import KINDS
from vehicle.combination.description import load_vehicle
from vehicle.rover.description import load_rover, rover_names

ROOT: Final = Path(__file__).resolve().parents[2]
PAGES: Final = sorted(page for page in ROOT.glob("docs/**/*.md") if page.parent.name != "reference")  # that one is made
DOCUMENTS: Final = sorted([*ROOT.glob("*.md"), *PAGES, *ROOT.glob("[a-z]*/README.md")])
ROOMS: Final = ("vehicle", "sensors", "estimators", "controllers", "scenarios", "offtrack")
MOST_WORDS: Final = 700  # in the README; all of it counts: text, tables, code and the addresses of links

FENCE: Final = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK: Final = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
SPAN: Final = re.compile(r"`(offtrack [^`]+)`")
HEADING: Final = re.compile(r"^#+ (.+)$", re.MULTILINE)


def ids(documents: list[Path]) -> list[str]:
    return [str(document.relative_to(ROOT)) for document in documents]


def text_of(document: Path) -> str:
    return document.read_text(encoding="utf-8")


def blocks(document: Path, language: str) -> list[str]:
    return [block for name, block in FENCE.findall(text_of(document)) if name == language]


def without_code(document: Path) -> str:
    return FENCE.sub("", text_of(document))


def anchors(document: Path) -> set[str]:
    """Anchors of the headings, as GitHub makes them."""
    headings = HEADING.findall(without_code(document))
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def write_modules(document: Path, folder: Path) -> Iterator[str]:
    """Write the Python blocks that begin with the name of their file; the names of their modules."""
    for block in blocks(document, "python"):
        name = re.match(r"# (\w+)\.py\n", block)
        if name:
            (folder / f"{name[1]}.py").write_text(block, encoding="utf-8")
            yield name[1]


def block_commands() -> Iterator[tuple[Path, str]]:
    """Command lines of the shell blocks, with their documents."""
    for document in DOCUMENTS:
        for block in blocks(document, "sh"):
            for line in block.replace("\\\n", " ").splitlines():
                if line.startswith("offtrack "):
                    yield document, line.removesuffix(" || true")


def parsed(words: list[str]) -> tuple[str, dict[str, Any]]:
    """Name and parameters of the subcommand that a command line calls; nothing is run.

    Raises:
        Exception: of the parser, if the command line is wrong.
    """
    called: list[tuple[str, dict[str, Any]]] = []

    def record(name: str, command: Any) -> None:
        for child, nested in getattr(command, "commands", {}).items():
            record(f"{name} {child}".strip(), nested)
        if not hasattr(command, "commands"):
            command.callback = lambda **parameters: called.append((name, parameters))

    command = typer.main.get_command(app)
    record("", command)
    command.main(args=words, prog_name="offtrack", standalone_mode=False)
    return called[0] if called else ("", {})


def check_scenario(name: str, settings: list[str]) -> None:
    """Load the scenario with the settings; a file that an earlier command writes does not exist yet."""
    if Path(name).suffix != ".toml":
        load_any_scenario(name, settings)


def axes(vary: list[str]) -> Iterator[str]:
    """One setting for every value of ``KEY=VALUE,VALUE``."""
    for axis in vary:
        key, _, values = axis.partition("=")
        yield from (f"{key}={value}" for value in values.split(","))


def check_study(parameters: dict[str, Any]) -> None:
    targets, settings = parameters.get("targets") or [parameters["scenario"]], list(parameters["settings"] or [])
    if len(targets) > 1:
        return  # finished runs
    (scenario,) = targets
    check_scenario(scenario, settings)
    for setting in axes([*(parameters["vary"] or []), *(parameters.get("judge_vary") or [])]):
        check_scenario(scenario, [*settings, setting])


def check_vehicle(name: str) -> None:
    if name.endswith(".toml"):
        return
    if name in rover_names():
        load_rover(name)
    else:
        load_vehicle(name)


def check(name: str, parameters: dict[str, Any]) -> None:
    """Check what a subcommand itself would refuse before it starts.

    Raises:
        ValueError: one line.
    """
    if name == "run":
        check_scenario(parameters["scenario"], list(parameters["settings"] or []))
    elif name in ("compare", "tune"):
        check_study(parameters)
        laws = parameters.get("controllers") or parameters.get("controller") or ""
        for law in laws.split(","):
            if law and ":" not in law:
                resolve("trailer_steering", law.partition("@")[0], TRAILER_STEERING)
    elif name == "reproduce":
        names_of(parameters["name"])
    elif name == "vehicle" and parameters["name"]:
        check_vehicle(parameters["like"] if parameters["name"] == "new" else parameters["name"])
    elif name == "assess":
        check_vehicle(parameters["vehicle"])
    elif name == "campaign" and parameters["target"] and not parameters["target"].endswith(".toml"):
        assert parameters["target"] in (*campaign_names(), *scenario_names())
    elif name == "parts" and parameters["kind"]:
        assert parameters["kind"] in KINDS
    elif name == "scenarios" and parameters["name"]:
        assert parameters["name"] in scenario_names()
    elif name == "keys" and parameters["scenario"]:
        check_scenario(parameters["scenario"], [])


def is_made_before(line: str) -> bool:
    """Whether a command names a file that one before it, or the reader, makes, or needs a bench beside it."""
    return bool(re.search(r"[\w./-]+\.(toml|csv|xodr|fmu|npz)\b|driver=|--udp|--can", line))


@pytest.mark.parametrize("document", DOCUMENTS, ids=ids(DOCUMENTS))
def test_every_relative_link_and_picture_resolves(document: Path) -> None:
    broken = []
    for link in LINK.findall(without_code(document)):
        if re.match(r"[a-z]+:", link):
            continue
        file, _, anchor = link.partition("#")
        target = (document.parent / file).resolve() if file else document
        if not target.exists() or (anchor and anchor not in anchors(target)):
            broken.append(link)
    assert not broken


def test_every_page_is_in_the_contents_of_the_site() -> None:
    index = text_of(ROOT / "docs" / "index.md")
    listed = {line for block in re.findall(r"```{toctree}\n(.*?)```", index, re.DOTALL) for line in block.splitlines()}
    assert {str(page.relative_to(ROOT / "docs").with_suffix("")) for page in PAGES} - listed == {"index"}


def test_the_readme_is_short() -> None:
    assert len(text_of(ROOT / "README.md").split()) <= MOST_WORDS


@pytest.mark.slow
@pytest.mark.parametrize(("document", "line"), [pytest.param(d, line, id=line) for d, line in block_commands()])
def test_every_command_of_a_shell_block_would_start(
    document: Path, line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Subcommand, options, scenario and keys are valid; a run begins, also with parts of one's own of the same page."""
    words = shlex.split(line, comments=True)[1:]
    if {"--help", "--install-completion"} & set(words):  # these end at once; the second writes to the home directory
        return
    modules = set(write_modules(document, tmp_path))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    try:
        own = re.findall(r"[= ](\w+:[A-Z]\w*)", line)
        for part in own:
            assert isinstance(resolve("part", part, Catalogue({})), type)
        name, parameters = parsed(words)
        check(name, parameters)
        if name == "run" and not is_made_before(line):
            settings = dict(setting.split("=", 1) for setting in parameters["settings"] or [])
            with offtrack.Session(parameters["scenario"], settings=settings) as session:
                assert session.step(0.3 if own else 0.05)
    finally:
        for module in modules & set(sys.modules):
            del sys.modules[module]


@pytest.mark.parametrize("document", DOCUMENTS, ids=ids(DOCUMENTS))
def test_every_command_in_the_text_is_one_with_these_options(document: Path) -> None:
    """The text says only the beginning of a command, or has words in capitals for what the reader fills in."""
    known = typer.main.get_command(app)
    for span in SPAN.findall(without_code(document)):
        command: Any = known
        options: set[str] = set()
        for word in span.split()[1:]:
            if hasattr(command, "commands") and not word.startswith("-"):
                assert word in command.commands, f"{span}: no command {word}"
                command = command.commands[word]
                options = {name for parameter in command.params for name in parameter.opts}
            elif word.startswith("--"):
                assert word in options, f"{span}: no option {word}"


@pytest.mark.parametrize("document", DOCUMENTS, ids=ids(DOCUMENTS))
def test_every_python_block_compiles_and_its_imports_work(document: Path) -> None:
    """A block is one module of its own. Modules of the rooms exist, and hold what is imported from them."""
    for block in blocks(document, "python"):
        compile(block, str(document), "exec")
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.ImportFrom) and str(node.module).split(".")[0] in ROOMS:
                module = importlib.import_module(str(node.module))
                assert [alias.name for alias in node.names if not hasattr(module, alias.name)] == []


def test_studies_and_campaigns_of_the_documentation_are_valid(tmp_path: Path) -> None:
    """The TOML blocks with axes to vary and with faults are read by the commands, and all their scenarios are valid."""
    tables = [block for page in PAGES for block in blocks(page, "toml")]
    campaigns = [block for block in tables if "[[fault]]" in block]
    studies = [block for block in tables if "[vary]" in block or "[draw]" in block if block not in campaigns]
    assert len(studies) >= 3
    assert campaigns
    for block in (*studies, *campaigns):
        (tmp_path / "file.toml").write_text(block, encoding="utf-8")
        read = (load_study if block in studies else load_campaign)(tmp_path / "file.toml")
        for case in read.cases():
            check_scenario(case.scenario, list(case.settings))
