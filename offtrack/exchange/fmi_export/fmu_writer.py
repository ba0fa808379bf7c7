"""Writer of FMUs: model description, sources, libraries for the platforms, and a page on the content."""

import hashlib
import importlib.util
import io
import math
import os
import subprocess
import sys
import uuid
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Final, NamedTuple
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from offtrack.exchange.fmi_export.plant_model import DISPLAY, Exported, PlantModel, Variable, base_unit, exported_plant
from scenarios.extras import check_extra
from scenarios.results.run_directory import replacing
from vehicle.engine.compiler import compiler, engine_name
from vehicle.foundation.temporary import temporary_folder

_STATES: Final = {2: "FMUstate", 3: "FMUState"}


def model_description(model: Exported, version: int, token: str, sources: Sequence[str]) -> bytes:
    """``modelDescription.xml``; ``sources`` are the C files to compile."""
    variables = model.variables
    root = Element("fmiModelDescription", fmiVersion=f"{version}.0", modelName=model.name)
    root.set("guid" if version == 2 else "instantiationToken", token)
    root.set("description", model.summary)
    root.set("generationTool", "offtrack")
    root.set("variableNamingConvention", "flat")
    simulation = SubElement(
        root, "CoSimulation", modelIdentifier=model.identifier, canHandleVariableCommunicationStepSize="true"
    )
    keeps = str(model.keeps_state).lower()
    simulation.set(f"canGetAndSet{_STATES[version]}", keeps)
    simulation.set(f"canSerialize{_STATES[version]}", keeps)
    if model.tool_only:
        simulation.set("needsExecutionTool", "true")
    if version == 2:
        simulation.set("canNotUseMemoryManagementFunctions", "true")
        files = SubElement(simulation, "SourceFiles")
        for name in sources:
            SubElement(files, "File", name=name)
    _units(root, variables)
    categories = SubElement(root, "LogCategories")
    SubElement(categories, "Category", name="logStatusError", description="why a call was refused")
    SubElement(root, "DefaultExperiment", startTime="0", stopTime=_number(model.stop), stepSize=_number(model.step))
    _variables(root, variables, version)
    _structure(root, variables, version)
    return xml_text(root)


def build_description(identifier: str, sources: Sequence[str]) -> bytes:
    """``sources/buildDescription.xml`` of FMI 3."""
    root = Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = SubElement(root, "BuildConfiguration", modelIdentifier=identifier)
    files = SubElement(configuration, "SourceFileSet", language="C99")
    for name in sources:
        SubElement(files, "SourceFile", name=name)
    return xml_text(root)


def _units(root: Element, variables: Iterable[Variable]) -> None:
    definitions = SubElement(root, "UnitDefinitions")
    for name in sorted({variable.signal.unit for variable in variables if variable.text is None} - {"-"}):
        unit = unit_element(definitions, name)
        if name in DISPLAY:
            display, factor = DISPLAY[name]
            SubElement(unit, "DisplayUnit", name=display, factor=_number(factor))


def unit_element(parent: Element, name: str, space: str = "") -> Element:
    """A unit with its SI exponents, in a name space; one of FMI has none if they depend on another number."""
    unit, base = SubElement(parent, f"{space}Unit", name=name), base_unit(name)
    if base is not None or space:
        exponents = {} if base is None else {si: str(exponent) for si, exponent in base.exponents.items()}
        of_unit = SubElement(unit, f"{space}BaseUnit", exponents)
        if base is not None and base.factor != 1.0:
            of_unit.set("factor", _number(base.factor))
    return unit


def _variables(root: Element, variables: Sequence[Variable], version: int) -> None:
    entries = SubElement(root, "ModelVariables")
    if version == 3:
        SubElement(
            entries,
            "Float64",
            name="time",
            valueReference="0",
            causality="independent",
            variability="continuous",
            description="time",
        )
    for variable in variables:
        signal, is_parameter, is_text = variable.signal, variable.causality == "parameter", variable.text is not None
        kind = ("String" if is_text else "Float64") if version == 3 else "ScalarVariable"
        entry = SubElement(entries, kind, name=signal.name)
        entry.set("valueReference", str(variable.reference))
        entry.set("description", signal.meaning)
        entry.set("causality", variable.causality)
        continuous = not (variable.held or is_text)
        entry.set("variability", "fixed" if is_parameter else "continuous" if continuous else "discrete")
        if variable.causality != "input":
            entry.set("initial", "exact" if is_parameter or variable.held else "calculated")
        has_start = variable.causality != "output" or variable.held
        if is_text:
            if version == 2:
                SubElement(entry, "String", {"start": variable.text or ""} if has_start else {})
            elif has_start:
                SubElement(entry, "Start", value=variable.text or "")
            continue
        value = SubElement(entry, "Real") if version == 2 else entry
        if signal.unit != "-":
            value.set("unit", signal.unit)
        for limit, number in (("min", signal.low), ("max", signal.high)):
            if number is not None and math.isfinite(number):
                value.set(limit, _number(number))
        if has_start:
            value.set("start", _number(signal.start))


def _structure(root: Element, variables: Sequence[Variable], version: int) -> None:
    """Outputs with the inputs that they follow at once; of FMI 2 by place, of FMI 3 by reference."""
    place = {variable.reference: str(k) for k, variable in enumerate(variables, start=1)}
    structure = SubElement(root, "ModelStructure")
    outputs = [variable for variable in variables if variable.causality == "output"]
    initial = [output for output in outputs if not output.held]
    for group, kind, of in (("Outputs", "Output", outputs), ("InitialUnknowns", "InitialUnknown", initial)):
        parent = SubElement(structure, group) if version == 2 and of else structure
        for output in of:
            entry = SubElement(parent, "Unknown" if version == 2 else kind)
            entry.set(
                "index" if version == 2 else "valueReference",
                place[output.reference] if version == 2 else str(output.reference),
            )
            if of is outputs:
                known = [place[r] if version == 2 else str(r) for r in output.feed_through]
                entry.set("dependencies", " ".join(known))


def _number(value: float) -> str:
    return repr(float(value))


def xml_text(root: Element) -> bytes:
    """The element as an XML file."""
    indent(root)
    content: bytes = tostring(root, encoding="utf-8")
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + content + b"\n"


class Platform(NamedTuple):
    """A platform: where its library lies in an FMU, and what Zig calls it."""

    folder_2: str | None  # FMI 2; None: that version has no name for it
    folder_3: str  # FMI 3
    suffix: str
    target: str


PLATFORMS: Final = {
    "linux64": Platform("linux64", "x86_64-linux", ".so", "x86_64-linux-gnu.2.17"),
    "win64": Platform("win64", "x86_64-windows", ".dll", "x86_64-windows-gnu"),
    "darwin64": Platform("darwin64", "x86_64-darwin", ".dylib", "x86_64-macos"),
    "linux-arm64": Platform(None, "aarch64-linux", ".so", "aarch64-linux-gnu.2.17"),
    "darwin-arm64": Platform(None, "aarch64-darwin", ".dylib", "aarch64-macos"),
}
_FLAGS: Final = ("-std=c99", "-shared", "-fPIC", "-fvisibility=hidden", "-fno-math-errno", "-w")
_LONGEST: Final = 400  # characters of a compiler's message


def checked_platforms(names: Sequence[str], version: int, *, by_python: bool = False) -> tuple[str, ...]:
    """The platforms, each once, linux64 first; ``by_python``: of an FMU behind which offtrack computes.

    Raises:
        ValueError: one line, if one is unknown, has no name in this version of FMI, or cannot be compiled or run.
    """
    if version not in (2, 3):
        raise ValueError(f"--fmi {version}: must be 2 or 3")
    for name in names:
        if name not in PLATFORMS:
            raise ValueError(f"--platform {name}: must be one of {', '.join(PLATFORMS)}")
        if by_python and not name.startswith("linux"):
            raise ValueError(
                f"--platform {name}: offtrack, which computes behind this FMU, runs on Linux only; use an FMU of "
                "'offtrack fmu plant' there"
            )
        if version == 2 and PLATFORMS[name].folder_2 is None:
            raise ValueError(f"--platform {name}: FMI 2 has no name for it; choose --fmi 3")
        if name != "linux64":
            check_extra("zig", f"--platform {name} needs", "ziglang")
    if not _has_zig() and (compiler() is None or sys.platform != "linux" or os.uname().machine != "x86_64"):
        raise ValueError(
            f"offtrack fmu plant: no C compiler for linux64 ({engine_name()}); install gcc, or Zig's compiler with: "
            "pip install 'offtrack[zig]'"
        )
    return tuple(dict.fromkeys(("linux64", *names)))


def library_path(platform: str, version: int, identifier: str) -> str:
    """Path of a platform's library in the FMU."""
    of = PLATFORMS[platform]
    return f"binaries/{of.folder_2 if version == 2 else of.folder_3}/{identifier}{of.suffix}"


def library(platform: str, sources: Path, files: Sequence[str], optimisation: int) -> bytes:
    """Content of the library of these C files in a folder.

    Raises:
        ValueError: one line with the compiler's message.
    """
    of, using = PLATFORMS[platform], compiler()
    with temporary_folder() as folder:
        built = Path(folder, f"library{of.suffix}")
        environment = dict(os.environ, ZIG_LOCAL_CACHE_DIR=str(folder))
        if _has_zig():
            command = [sys.executable, "-m", "ziglang", "cc", "-target", of.target, "-fno-sanitize=undefined", "-s"]
        else:
            assert using is not None
            command = list(using.command)
        math = [] if platform == "win64" else ["-lm"]
        arguments = [*command, *_FLAGS, f"-O{optimisation}", *files, "-o", str(built), *math]
        done = subprocess.run(arguments, cwd=sources, env=environment, capture_output=True, text=True, check=False)
        if done.returncode != 0 or not built.exists():
            raise ValueError(f"--platform {platform}: the compiler failed: {' '.join(done.stderr.split())[:_LONGEST]}")
        return built.read_bytes()


def _has_zig() -> bool:
    return importlib.util.find_spec("ziglang") is not None


_EPOCH: Final = (1980, 1, 1, 0, 0, 0)  # of every entry: the same plant gives the same file


def write_fmu(path: Path, model: PlantModel, version: int, platforms: Sequence[str], *, optimisation: int = 2) -> None:
    """Write the FMU of a plant with its libraries; nothing is left of one that fails.

    Raises:
        ValueError: one line, if a library cannot be compiled.
        OSError: if the file cannot be written.
    """
    with replacing(path) as unfinished:
        unfinished.write_bytes(fmu_bytes(exported_plant(model, version), version, platforms, optimisation=optimisation))


def fmu_bytes(exported: Exported, version: int, platforms: Sequence[str], *, optimisation: int = 2) -> bytes:
    """Content of an FMU with its libraries.

    Raises:
        ValueError: one line, if a library cannot be compiled.
    """
    token = _token(exported, version)
    sources = {**exported.sources, "token.h": f'#define TOKEN "{token}"\n'}
    compiled = sorted(name for name in sources if name.endswith(".c"))
    files: dict[str, bytes] = {
        "modelDescription.xml": model_description(exported, version, token, compiled),
        "documentation/index.html": _page(exported),
        **{f"resources/{name}": content for name, content in exported.resources.items()},
        **{f"sources/{name}": text.encode() for name, text in sources.items()},
    }
    if version == 3:
        files["sources/buildDescription.xml"] = build_description(exported.identifier, compiled)
    with temporary_folder() as folder:
        for name, text in sources.items():
            Path(folder, name).write_text(text, encoding="utf-8")
        for platform in platforms:
            content = library(platform, Path(folder), compiled, optimisation)
            files[library_path(platform, version, exported.identifier)] = content
    return zipped(files)


def _token(exported: Exported, version: int) -> str:
    """Token that changes with the sources, names and start values, and with the resources."""
    digest = hashlib.sha256("\0".join([*exported.sources.values(), str(version)]).encode())
    for name, content in sorted(exported.resources.items()):
        digest.update(name.encode() + b"\0" + content)
    return "{" + str(uuid.uuid5(uuid.NAMESPACE_URL, digest.hexdigest())) + "}"


def _page(exported: Exported) -> bytes:
    from jinja2 import Environment

    template = (resources.files("offtrack.exchange.fmi_export") / "page.html.j2").read_text(encoding="utf-8")
    page = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True).from_string(template)
    return page.render(model=exported).encode()


def zipped(files: Mapping[str, bytes]) -> bytes:
    """A zip file of these members, the same for the same content."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, member in files.items():
            entry = zipfile.ZipInfo(name, _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            archive.writestr(entry, member)
    return content.getvalue()
