"""The page docs/trust.md: its limits are those of the code, and the code uses nothing that it excludes."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

from controllers.trailer_steering import policy
from offtrack.exchange.bench import links
from offtrack.studies import study
from vehicle.foundation import user_file
from vehicle.foundation.user_file import FileKind, FileType

ROOT: Final = Path(__file__).resolve().parents[2]
ROOMS: Final = ("vehicle", "sensors", "estimators", "controllers", "scenarios", "offtrack")
OWN_TYPES: Final = (policy, study, links)  # modules with types of files of their own
PAGE: Final = ROOT / "docs" / "trust.md"

UNPICKLING: Final = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "marshal", "shelve"}
NETWORK: Final = {"socket", "ssl", "urllib", "http", "ftplib", "smtplib", "socketserver", "asyncio", "requests"}
RUNNING: Final = {"eval", "exec", "compile", "__import__"}
PROGRAMS: Final = {"system", "popen", "execv", "execve", "execvp", "execl", "spawnv", "spawnl", "fork", "startfile"}
# The only modules that may start a program, reach a network or import by name, with the functions that they use for it.
ALLOWED: Final = {
    ("vehicle/engine/compiler.py", "subprocess"),  # the C compiler
    ("offtrack/exchange/fmi_export/fmu_writer.py", "subprocess"),  # the C compiler, or Zig's
    ("offtrack/exchange/fmi_import/instance.py", "subprocess"),  # Python, for the library of an FMU that the user names
    ("offtrack/exchange/bench/links.py", "socket"),  # to the bench that --udp names
    ("offtrack/reports/watching.py", "http"),  # on 127.0.0.1 alone, for who has the link of --watch
    ("offtrack/reports/watching.py", "urllib"),  # splits addresses
    ("offtrack/exchange/fmi_proxy/proxy.py", "urllib"),  # splits addresses
    ("offtrack/exchange/fmi_import/host.py", "import_module"),  # FMPy's module of the version of FMI
    ("scenarios/extras.py", "import_module"),  # packages of an extra, by a table
    ("scenarios/catalogue.py", "import_module"),  # parts: own, or the user's
    ("offtrack/commands/cli.py", "import_module"),  # own commands, when they are called
    ("offtrack/__init__.py", "import_module"),  # own names, on their first use
    ("offtrack/runs.py", "import_module"),  # pandas
    ("offtrack/studies/reproduce/reproduction.py", "import_module"),  # own figures only
    ("offtrack/studies/cluster_executor.py", "import_module"),  # classes of dask-jobqueue, by a table
    ("vehicle/foundation/user_cache.py", "pickle"),  # what this user has made, in a cache that nobody else can write to
    ("scenarios/loop/channel.py", "pickle"),  # own rows, in a temporary file that has no name
}


def misuses(source: str, file: str) -> Iterator[str]:
    """Names in a module's source that unpickle, reach the network, or run what is not the module's own."""
    for node in ast.walk(ast.parse(source)):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name.split(".")[0] for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [(node.module or "").split(".")[0], *(alias.name for alias in node.names)]
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            names = [node.func.id] if node.func.id in RUNNING else []
        elif isinstance(node, ast.Attribute):
            of_os = isinstance(node.value, ast.Name) and node.value.id == "os" and node.attr in PROGRAMS
            names = [node.attr] if of_os or node.attr == "import_module" else []
        elif isinstance(node, ast.keyword):
            constant = isinstance(node.value, ast.Constant) and node.value.value is True
            names = [node.arg or ""] if constant and node.arg in ("shell", "allow_pickle") else []
        forbidden = UNPICKLING | NETWORK | RUNNING | PROGRAMS | {"subprocess", "import_module", "shell", "allow_pickle"}
        yield from (name for name in names if name in forbidden and (file, name) not in ALLOWED)


def modules() -> list[str]:
    return sorted(str(path.relative_to(ROOT)) for room in ROOMS for path in (ROOT / room).rglob("*.py"))


@pytest.mark.slow
def test_no_module_can_unpickle_reach_the_network_or_start_a_program() -> None:
    found = {file: names for file in modules() if (names := list(misuses((ROOT / file).read_text("utf-8"), file)))}
    assert found == {}


@pytest.mark.parametrize(
    "source",
    [
        "import pickle",
        "from urllib import request",
        "import urllib.request",
        "import subprocess",
        "from os import system",
        "os.system('true')",
        "eval('1')",
        "run('true', shell=True)",
        "np.load(path, allow_pickle=True)",
        "importlib.import_module(name)",
        "from importlib import import_module",
    ],
)
def test_each_of_these_would_be_noticed(source: str) -> None:
    assert list(misuses(source, "vehicle/new.py"))


def test_the_page_states_every_limit_of_the_code() -> None:
    text = PAGE.read_text(encoding="utf-8")
    stated = dict(re.findall(r"^\| (an? [^|]+) \| ([\d.]+) MB \|$", text, re.MULTILINE))
    types = [*FileKind, *(kind for module in OWN_TYPES for kind in vars(module).values() if type(kind) is FileType)]
    assert {noun: float(size) * 1e6 for noun, size in stated.items()} == {kind.noun: kind.limit for kind in types}
    declaring = {file for file in modules() if re.search(r"= FileType\(", (ROOT / file).read_text("utf-8"))}
    assert declaring == {str(Path(module.__file__ or "").relative_to(ROOT)) for module in OWN_TYPES}
    for number in (user_file.MAX_FIELD, user_file.MAX_NESTING, user_file.MAX_MEMBERS):
        assert f"| {number:,} |".replace(",", " ") in text
    for number in (user_file.MAX_PIXELS, user_file.MAX_NUMBERS):
        assert f"| {number / 1e6:g} million |" in text
