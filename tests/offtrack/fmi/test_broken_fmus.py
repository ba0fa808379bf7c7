"""FMUs that are broken in their files or functions: one line each, nothing hangs, nothing is left or escapes."""

import shutil
import stat
import struct
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import pytest

from offtrack.exchange.fmi_import.fmu_file import open_fmu
from offtrack.exchange.fmi_import.fmu_parts import law_signals
from offtrack.exchange.fmi_import.instance import FmuInstance
from offtrack.exchange.fmi_import.mapping import read_map
from tests.fmus.models import LAW as QUANTITIES
from tests.fmus.models import TOKEN, description, description_3, proportional_law

SIGNALS: Final = law_signals(2, 2)
LIBRARY: Final = "binaries/linux64/law.so"
XML: Final = "modelDescription.xml"
Members = dict[str, bytes]
Change = Callable[[Members], None]


@pytest.fixture(scope="module")
def law(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return proportional_law(tmp_path_factory.mktemp("law"))


@pytest.fixture
def own_law(law: Path, tmp_path: Path) -> Path:
    (tmp_path / "inbox").mkdir()
    return Path(shutil.copy(law, tmp_path / "inbox" / "own.fmu"))


@pytest.fixture(autouse=True)
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder for temporary files; after the test it is empty, and the FMU and its map are the only files."""
    folder, work = tmp_path / "temporary", tmp_path / "work"
    folder.mkdir()
    work.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.chdir(work)
    yield folder
    left = {file.name for file in tmp_path.rglob("*") if file.is_file()}
    assert left <= {"own.fmu", "own.fmu.toml"}
    assert list(folder.iterdir()) == []
    assert not Path("/tmp/escaped.txt").exists()


def _with(name: str, content: bytes) -> Change:
    return lambda members: members.update({name: content})


def _without(name: str) -> Change:
    def change(members: Members) -> None:
        for key in [key for key in members if key.startswith(name)]:
            del members[key]

    return change


def _moved(old: str, new: str) -> Change:
    return lambda members: members.update({new: members.pop(old)})


def _edited(old: str, new: str) -> Change:
    def change(members: Members) -> None:
        text = members[XML].decode()
        assert old in text
        members[XML] = text.replace(old, new).encode()

    return change


def _all(*changes: Change) -> Change:
    def change(members: Members) -> None:
        for one in changes:
            one(members)

    return change


FMI_3: Final = description_3("law", QUANTITIES).encode()
EXPERIMENT: Final = '<DefaultExperiment stepSize="{}"/><ModelVariables>'
UNIT: Final = '<UnitDefinitions><Unit name="m"><BaseUnit m="1" factor="{}"/></Unit></UnitDefinitions><ModelVariables>'
MILLION: Final = 1_000_000 * '<ScalarVariable name="x"><Real/></ScalarVariable>'
BROKEN: Final[dict[str, tuple[Change, str]]] = {
    "no description": (_without(XML), "holds no modelDescription.xml"),
    "description in a folder": (_moved(XML, f"law/{XML}"), "holds no modelDescription.xml"),
    "no library": (_without("binaries/"), "has no library 'linux64' for this machine"),
    "no library but sources": (
        _all(_without("binaries/"), _with("sources/law.c", b"int x;")), "compile it from its sources: fmpy compile",
    ),
    "library of another machine": (_moved(LIBRARY, "binaries/win64/law.dll"), "it has win64"),
    "library of another version of FMI": (_moved(LIBRARY, "binaries/x86_64-linux/law.so"), "it has x86_64-linux"),
    "model whose name leaves": (_edited('modelIdentifier="law"', 'modelIdentifier="../../law"'), "has no library"),
    "model without a name": (_edited('modelIdentifier="law"', ""), "modelIdentifier"),
    "XML that breaks off": (_with(XML, b'<fmiModelDescription fmiVersion="2.0"'), "modelDescription.xml:"),
    "empty XML": (_with(XML, b""), "must be 2 or 3"),
    "other XML": (_with(XML, b'<html fmiVersion="3.0"/>'), "modelDescription.xml:"),
    "XML of bytes": (_with(XML, b'fmiVersion="2.0"' + bytes(range(256))), "modelDescription.xml:"),
    "document type": (
        lambda members: members.update({XML: b"<!DOCTYPE x [<!ENTITY a 'a'>]>" + members[XML][38:]}),
        "a document type is refused",
    ),
    "FMI 1": (_edited('fmiVersion="2.0"', 'fmiVersion="1.0"'), "must be 2 or 3"),
    "FMI 3 by its version alone": (_edited('fmiVersion="2.0"', 'fmiVersion="3.0"'), "own.fmu"),
    "FMI 2 by its version alone": (_with(XML, FMI_3.replace(b'fmiVersion="3.0"', b'fmiVersion="2.0"')), "own.fmu"),
    "no variables": (_with(XML, description("law", ()).encode()), "has no scalar variables"),
    "model exchange only": (_edited("CoSimulation", "ModelExchange"), "is for model exchange only"),
    "scheduled execution only": (
        _with(XML, FMI_3.replace(b"CoSimulation", b"ScheduledExecution")), "export it for co-simulation",
    ),
    "an output less": (_edited("steer_demand_2", "steer"), "no variable is connected to trailer_steering's signal"),
    "outputs that are texts": (_edited('<Real unit="rad"/>', "<String/>"), "own.fmu"),
    "reference that is none": (_edited('valueReference="0"', 'valueReference="many"'), "modelDescription.xml:"),
    "reference below zero": (_edited('valueReference="0"', 'valueReference="-4"'), "valueReference"),
    "a name twice": (_edited('name="steer_demand_2"', 'name="steer_demand_1"'), "steer_demand_1"),
    "a unit of something else": (_edited('<Real unit="m"', '<Real unit="s"'), "is in s, the signal off_tracking in m"),
    "a unit that is not known": (_edited('<Real unit="m"', '<Real unit="furlong"'), "furlong"),
    "a unit whose factor is none": (_edited("<ModelVariables>", UNIT.format("much")), "own.fmu"),
    "a unit whose factor is NaN": (_edited("<ModelVariables>", UNIT.format("NaN")), "factor"),
    "a step below zero": (_edited("<ModelVariables>", EXPERIMENT.format("-0.01")), "must be"),
    "a step that is not a number": (_edited("<ModelVariables>", EXPERIMENT.format("NaN")), "must be"),
    "a step of a thousandth of a tick": (_edited("<ModelVariables>", EXPERIMENT.format("1e-6")), "milliseconds"),
    "a path upwards": (_with("../../escaped.txt", b"!"), "leaves the archive"),
    "a path upwards in the middle": (_with("resources/../../../escaped.txt", b"!"), "leaves the archive"),
    "a path from the root": (_with("/tmp/escaped.txt", b"!"), "leaves the archive"),
    "a path of Windows": (_with("C:\\escaped.txt", b"!"), "leaves the archive"),
    "a path with backslashes": (_with("..\\escaped.txt", b"!"), "leaves the archive"),
    "a path of a point": (_with("./", b""), "leaves the archive or is no file"),
    "a path of a point and a file": (_with(".", b"!"), "leaves the archive or is no file"),
    "a million variables": (_edited("<ModelVariables>", f"<ModelVariables>{MILLION}"), "must have at most 500000"),
    "a comment of 80 MB": (_edited("<ModelVariables>", f"<!--{80_000_000 * 'x'}--><ModelVariables>"), "has 80 MB"),
    "a document type in UTF-7": (
        _with(XML, b'<?xml version="1.0" encoding="UTF-7"?>+ADwAIQ-DOCTYPE x [] +AD4 fmiVersion="2.0"'),
        "encoding utf-7: must be UTF-8",
    ),
    "a document type in UTF-16": (_with(XML, "<!DOCTYPE x []>fmiVersion='2.0'".encode("utf-16")), "must be 2 or 3"),
    "too many members": (
        lambda members: members.update({f"resources/{k}": b"" for k in range(1001)}), "must be at most 1000",
    ),
}  # fmt: skip
LOADED: Final[dict[str, tuple[Change, str]]] = {
    "library is text": (_with(LIBRARY, b"no machine code"), "Failed to load shared library"),
    "empty library": (_with(LIBRARY, b""), "file too short"),
    "another GUID": (_edited(TOKEN, "{0}"), "cannot be started"),
}


def rewritten(path: Path, change: Change) -> None:
    with zipfile.ZipFile(path) as archive:
        members = {member: archive.read(member) for member in archive.namelist()}
    change(members)
    with zipfile.ZipFile(path, "w") as archive:
        for member, content in members.items():
            archive.writestr(member, content)


def opened(path: Path) -> FmuInstance:
    fmu = open_fmu(path)
    return FmuInstance(fmu, read_map(fmu, SIGNALS), {})


def check_refused(path: Path, line: str) -> None:
    begin = time.monotonic()
    with pytest.raises(ValueError) as caught:  # noqa: PT011 -- the text is looked at below
        opened(path)
    text = str(caught.value)
    assert line in text
    assert path.name in text
    assert "\n" not in text
    assert len(text) < 1000
    assert time.monotonic() - begin < 20.0


@pytest.mark.parametrize("name", [*BROKEN, *LOADED])
def test_a_broken_fmu_is_one_line(own_law: Path, name: str) -> None:
    """Most are refused by their description, before anything of them runs."""
    change, line = (BROKEN | LOADED)[name]
    rewritten(own_law, change)
    check_refused(own_law, line)


@pytest.mark.parametrize("kind", [stat.S_IFLNK, stat.S_IFIFO, stat.S_IFCHR, stat.S_IFSOCK])
def test_members_that_are_no_files_are_refused(kind: int, own_law: Path) -> None:
    link = zipfile.ZipInfo("resources/link")
    link.create_system = 3  # Unix
    link.external_attr = (kind | 0o777) << 16
    with zipfile.ZipFile(own_law, "a") as archive:
        archive.writestr(link, "../../escaped.txt")
    check_refused(own_law, "leaves the archive")


def test_an_archive_that_would_fill_the_disk_is_refused(own_law: Path) -> None:
    """A member says in the directory that it is of 3 GB unpacked."""
    content = bytearray(own_law.read_bytes())
    at = content.rindex(b"PK\1\2")
    struct.pack_into("<I", content, at + 24, 3_000_000_000)
    own_law.write_bytes(bytes(content))
    check_refused(own_law, "must be at most 1000 MB")


def test_a_locked_member_is_refused(own_law: Path) -> None:
    content = bytearray(own_law.read_bytes())
    for mark, flags in ((b"PK\1\2", 8), (b"PK\3\4", 6)):
        content[content.index(mark) + flags] |= 1  # encrypted
    own_law.write_bytes(bytes(content))
    check_refused(own_law, "no readable zip file")


def test_files_that_are_no_archives_are_one_line(own_law: Path) -> None:
    content = own_law.read_bytes()
    for broken, line in ((b"", "no readable zip"), (b"PK\3\4" + b"x" * 100, "no readable zip"), (content[:-90], "zip")):
        own_law.write_bytes(broken)
        check_refused(own_law, line)
    damaged = bytearray(content)
    damaged[content.index(b"fmiVersion")] ^= 0xFF
    own_law.write_bytes(bytes(damaged))
    check_refused(own_law, "damaged")
    own_law.unlink()
    check_refused(own_law, "cannot be read")
