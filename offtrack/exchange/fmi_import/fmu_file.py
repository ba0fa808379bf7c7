"""Open FMU files: checked, unpacked into a private folder, described; their units and parameters."""

import io
import math
import platform
import re
import stat
import sys
import zipfile
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Final, NamedTuple

from scenarios.extras import import_extra
from vehicle.foundation.user_file import MAX_MEMBERS, FileKind, read_bytes, shown
from vehicle.option import Option

_LARGEST: Final = 1_000_000_000  # unpacked [bytes]
_LARGEST_DESCRIPTION: Final = 64_000_000  # [bytes]
_MOST_ELEMENTS: Final = 500_000  # of a description, some three for a variable
_ENCODING: Final = re.compile(rb"""(?:\xef\xbb\xbf)?\s*<\?xml[^>]{0,100}?encoding\s*=\s*["']([!-~]{0,40}?)["']""")
_ENCODINGS: Final = ("utf-8", "utf8", "us-ascii", "ascii", "iso-8859-1", "windows-1252")
_END_OF_REFERENCES: Final = 2**32
_FMI_VERSION: Final = re.compile(rb"""fmiVersion\s*=\s*["']([^"']*)["']""")
_REAL: Final = ("Real", "Float64", "Float32")
_WHOLE: Final = ("Integer", "Enumeration", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64")


@dataclass(frozen=True, slots=True, kw_only=True)
class Variable:
    """A scalar variable of an FMU."""

    name: str
    reference: int
    kind: str  # its type in the FMI standard, such as Real or Float64
    causality: str  # input, output, parameter, …
    start: str | None
    unit: str  # as the FMU names it; empty: none
    factor: float = 1.0  # of its unit: SI value = factor * value + offset
    offset: float = 0.0
    exponents: tuple[tuple[str, int], ...] = ()  # of the SI base units of its unit
    meaning: str = ""
    low: float | None = None
    high: float | None = None

    @property
    def is_number(self) -> bool:
        """True for a number or a truth value."""
        return self.kind in _REAL or self.kind in _WHOLE or self.kind == "Boolean"


@dataclass(frozen=True, slots=True, kw_only=True)
class FmuFile:
    """Description of an FMU for co-simulation."""

    path: Path
    version: int  # of FMI: 2 or 3
    token: str  # GUID or instantiation token
    identifier: str  # of the model: name of its library
    step: float | None  # it asks for, or accepts only [s]; None: any
    fixed_step: bool  # it accepts no other
    keeps_state: bool  # its state can be taken, kept as bytes and set
    variables: dict[str, Variable]
    tool: str = ""  # that wrote it

    def unpack(self, folder: Path) -> None:
        """Unpack into a private folder.

        Raises:
            ValueError: one line, for members that leave the folder, or are too many or too large.
        """
        with zipfile.ZipFile(self.path) as archive:
            archive.extractall(folder, members=_safe_members(self.path, archive))


def open_fmu(path: Path) -> FmuFile:
    """Read and check an FMU.

    Raises:
        ValueError: one line with the file and what is wrong with it.
    """
    fmpy = import_extra("fmi", f"{path}: FMUs need", "fmpy")
    content = io.BytesIO(read_bytes(path, FileKind.FMU))
    try:
        with zipfile.ZipFile(content) as archive:
            names = {member.filename for member in _safe_members(path, archive)}
            broken = archive.testzip()
    except (zipfile.BadZipFile, zipfile.LargeZipFile, NotImplementedError, RuntimeError, EOFError, OSError) as error:
        raise ValueError(f"{path}: not an FMU: no readable zip file ({shown(str(error), 80)})") from None
    if broken is not None:
        raise ValueError(f"{path}: not an FMU: its member '{shown(broken, 80)}' is damaged")
    if "modelDescription.xml" not in names:
        raise ValueError(f"{path}: not an FMU: it holds no modelDescription.xml")
    version = _version(path, content)
    description = _description(fmpy, path, content)
    simulation = description.coSimulation
    if simulation is None:
        raise ValueError(f"{path}: is for model exchange only: export it for co-simulation")
    if not simulation.modelIdentifier:
        raise ValueError(f"{path}: modelDescription.xml: CoSimulation has no modelIdentifier, the name of its library")
    _check_binary(fmpy, path, names, version, str(simulation.modelIdentifier))
    fixed = getattr(simulation, "fixedInternalStepSize", None)
    strict = simulation.canHandleVariableCommunicationStepSize is False and fixed is not None
    wished = fixed if fixed is not None else getattr(description.defaultExperiment, "stepSize", None)
    step = None if wished is None else _number(wished)
    if wished is not None and step is None:
        raise ValueError(f"{path}: modelDescription.xml: step size = '{shown(str(wished), 40)}' must be a number")
    return FmuFile(
        path=path,
        version=version,
        token=str(description.guid if version == 2 else description.instantiationToken),
        identifier=str(simulation.modelIdentifier),
        step=step,
        fixed_step=strict,
        keeps_state=bool(simulation.canGetAndSetFMUstate and simulation.canSerializeFMUstate),
        variables=_variables(path, description),
        tool=str(description.generationTool or ""),
    )


def _description(fmpy: Any, path: Path, content: io.BytesIO) -> Any:
    try:
        return fmpy.read_model_description(content, validate=False)
    except Exception as error:  # of any type: FMPy reads it with a parser of XML and looks for what should be there
        reason = " ".join(f"{error}".split()) or type(error).__name__
        raise ValueError(f"{path}: modelDescription.xml: {shown(reason, 200)}") from None


def _version(path: Path, content: io.BytesIO) -> int:
    """Version of FMI; looked for before all else, as the other ones describe models differently.

    Raises:
        ValueError: one line, if the description is of no such version, or one that a parser should not see.
    """
    with zipfile.ZipFile(content) as archive:
        size = archive.getinfo("modelDescription.xml").file_size
        xml = archive.read("modelDescription.xml") if size <= _LARGEST_DESCRIPTION else b""
    declared = _ENCODING.match(xml)
    encoding = declared[1].decode("ascii").lower() if declared else "utf-8"
    if size > _LARGEST_DESCRIPTION:
        refusal = f"has {size / 1e6:.0f} MB: must have at most {_LARGEST_DESCRIPTION / 1e6:.0f} MB"
    elif (elements := xml.count(b"<")) > _MOST_ELEMENTS:
        refusal = f"has {elements} elements: must have at most {_MOST_ELEMENTS}"
    elif encoding not in _ENCODINGS:
        refusal = f"encoding {shown(encoding, 40)}: must be UTF-8, as FMI asks for"
    elif b"<!DOCTYPE" in xml:  # it could define entities, and name other files
        refusal = "a document type is refused"
    else:
        refusal = ""
    if refusal:
        raise ValueError(f"{path}: modelDescription.xml: {refusal}")
    found = _FMI_VERSION.search(xml)
    text = found[1].decode(errors="replace") if found else "unknown"
    if not text.startswith(("2.", "3.")):
        raise ValueError(f"{path}: is of FMI version {shown(text, 20)}: must be 2 or 3")
    return int(text[0])


def _check_binary(fmpy: Any, path: Path, names: set[str], version: int, identifier: str) -> None:
    """Refuse an FMU without a library for this machine."""
    folder, suffix = fmpy.platform if version == 2 else fmpy.platform_tuple, fmpy.sharedLibraryExtension
    if f"binaries/{folder}/{identifier}{suffix}" in names:
        return
    library = f"{shown(identifier, 60)}{suffix}"
    others = [name for name in names if name.startswith(f"binaries/{folder}/") and name.endswith(suffix)]
    if others:
        raise ValueError(f"{path}: has no library '{library}', as its description names it, but {shown(others[0], 80)}")
    there = sorted({PurePosixPath(name).parts[1] for name in names if name.startswith("binaries/") and name[9:]})
    sources = any(name.startswith("sources/") and name[8:] for name in names)
    has = f"it has {', '.join(there)}" if there else "it has none"
    cure = "; compile it from its sources: fmpy compile" if sources else ""
    machine = f"{platform.system()} {platform.machine()}"
    raise ValueError(f"{path}: has no library '{folder}' for this machine ({machine}, {sys.byteorder}): {has}{cure}")


def _variables(path: Path, description: Any) -> dict[str, Variable]:
    units = {unit.name: unit for unit in description.unitDefinitions or ()}
    variables: dict[str, Variable] = {}
    for one in description.modelVariables:
        if getattr(one, "dimensions", None):
            continue  # arrays are of no use as signals
        name, reference = str(one.name), int(one.valueReference)
        if name in variables:
            raise ValueError(f"{path}: modelDescription.xml: two variables are named '{shown(name, 60)}'")
        if not 0 <= reference < _END_OF_REFERENCES:
            raise ValueError(
                f"{path}: modelDescription.xml: variable '{shown(name, 60)}': valueReference = {reference} must be "
                f"from 0 to {_END_OF_REFERENCES - 1}"
            )
        declared = one.declaredType
        unit = str(one.unit or getattr(declared, "unit", None) or "")
        base = getattr(units.get(unit), "baseUnit", None)
        factor, offset = (1.0, 0.0) if base is None else (float(base.factor), float(base.offset))
        if not (math.isfinite(factor) and math.isfinite(offset) and factor != 0.0):
            raise ValueError(
                f"{path}: modelDescription.xml: unit '{shown(unit, 40)}': factor = {factor} and offset = {offset} "
                "must be finite, and the factor not 0"
            )
        variables[name] = Variable(
            name=name,
            reference=reference,
            kind=str(one.type),
            causality=str(one.causality),
            start=None if one.start is None else str(one.start),
            unit=unit,
            factor=factor,
            offset=offset,
            exponents=_exponents(base),
            meaning=str(one.description or ""),
            low=_number(one.min),
            high=_number(one.max),
        )
    if not variables:
        raise ValueError(f"{path}: has no scalar variables")
    return variables


def _exponents(base: Any) -> tuple[tuple[str, int], ...]:
    names = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
    return () if base is None else tuple((name, int(getattr(base, name))) for name in names if getattr(base, name))


def _number(value: Any) -> float | None:
    try:
        return None if value is None else float(value)
    except (TypeError, ValueError):
        return None


def _safe_members(path: Path, archive: zipfile.ZipFile) -> list[zipfile.ZipInfo]:
    """Members of an archive, none of which leaves the folder that it is unpacked into."""
    members = archive.infolist()
    if len(members) > MAX_MEMBERS:
        raise ValueError(f"{path}: has {len(members)} members: must be at most {MAX_MEMBERS}")
    size = sum(member.file_size for member in members)
    if size > _LARGEST:
        raise ValueError(f"{path}: is {size / 1e6:.0f} MB unpacked: must be at most {_LARGEST / 1e6:.0f} MB")
    for member in members:
        place = PurePosixPath(member.filename.replace("\\", "/"))
        kind = stat.S_IFMT(member.external_attr >> 16)
        inside = place.parts and not place.is_absolute() and ".." not in place.parts and ":" not in place.parts[0]
        if not inside or kind not in (0, stat.S_IFREG, stat.S_IFDIR):
            name = shown(member.filename, 80)
            raise ValueError(f"{path}: its member '{name}' leaves the archive or is no file: refused")
    return members


class Scale(NamedTuple):
    """A unit: the SI unit it stands for, and SI value = factor * value + offset."""

    si: str
    factor: float = 1.0
    offset: float = 0.0


_G: Final = 9.80665  # [m/s2]
UNITS: Final = {
    **{si: Scale(si) for si in ("-", "s", "m", "rad", "m/s", "m/s2", "rad/s", "N", "1/m")},
    "1": Scale("-"),
    "": Scale("-"),
    "%": Scale("-", 0.01),
    "ms": Scale("s", 1e-3),
    "mm": Scale("m", 1e-3),
    "deg": Scale("rad", math.radians(1.0)),
    "degree": Scale("rad", math.radians(1.0)),
    "km/h": Scale("m/s", 1.0 / 3.6),
    "m/s^2": Scale("m/s2"),
    "g": Scale("m/s2", _G),
    "deg/s": Scale("rad/s", math.radians(1.0)),
    "kN": Scale("N", 1e3),
}  # by the names in a map, and in FMUs that do not define their units
_BASE: Final = {
    (): "-",
    (("s", 1),): "s",
    (("m", 1),): "m",
    (("rad", 1),): "rad",
    (("m", 1), ("s", -1)): "m/s",
    (("m", 1), ("s", -2)): "m/s2",
    (("s", -1), ("rad", 1)): "rad/s",
    (("s", -1),): "rad/s",  # radians may be left out
    (("kg", 1), ("m", 1), ("s", -2)): "N",
    (("m", -1),): "1/m",
}  # SI units by exponents, in the order of the FMI standard


def declared_scale(variable: Variable) -> Scale | None:
    """Unit that the FMU declares for a variable; None if it declares none, or one of no signal."""
    if variable.exponents or (variable.unit and (variable.factor, variable.offset) != (1.0, 0.0)):
        si = _BASE.get(variable.exponents)
        return None if si is None else Scale(si, variable.factor, variable.offset)
    return UNITS.get(variable.unit) if variable.unit else None


def fits(scale: Scale, si: str) -> bool:
    """True if a unit measures what an SI unit does; angles may be given as plain numbers, as FMI allows."""
    return scale.si == si or {scale.si, si} <= {"-", "rad"}


def options_of(fmu: FmuFile) -> tuple[Option, ...]:
    """Options for the numeric parameters of an FMU whose names are plain words; a map can set the others too."""
    return tuple(
        Option(
            name,
            None,
            " ".join(one.meaning.split()) or "parameter of the FMU",
            one.unit or "-",
            -math.inf if one.low is None else one.low,
            math.inf if one.high is None else one.high,
            default_text=one.start or "0",
        )
        for name, one in fmu.variables.items()
        if one.causality == "parameter" and one.is_number and name.isidentifier()
    )
