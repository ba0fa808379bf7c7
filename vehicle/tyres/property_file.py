"""Reader of tyre property files (.tir) of MF-Tyre, Adams and others: Magic Formula 5.2, 6.1 and 6.2.

The units of a file hold for what has a unit: loads, lengths, speeds, pressures, stiffnesses and the ranges of angles.
Coefficients are those of the formulas in radians. Pressures without a unit of their own are force over length squared.
"""

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

from vehicle.foundation.quantity import Frozen, check_number, checked, quantity
from vehicle.foundation.user_file import FileKind, nearest, read_bytes, shown
from vehicle.tyres.magic_formula import ASYMMETRIES, COEFFICIENTS, DEFAULTS, Coefficients, PropertyFileTyre

_KEY: Final = re.compile(r"\s*([A-Za-z]\w*)\s*=\s*('[^']*'|\"[^\"]*\"|[^$!]*)")
_SECTION: Final = re.compile(r"\s*\[\s*(\w+)\s*\]")
_INCH, _POUND, _FEET = 0.0254, 4.4482216152605, 0.3048
_UNITS: Final[Mapping[str, Mapping[str, float]]] = {  # SI units in each
    "LENGTH": {"meter": 1.0, "m": 1.0, "millimeter": 1e-3, "mm": 1e-3, "centimeter": 1e-2, "cm": 1e-2, "kilometer": 1e3,
               "km": 1e3, "inch": _INCH, "in": _INCH, "foot": _FEET, "ft": _FEET},
    "FORCE": {"newton": 1.0, "n": 1.0, "kilonewton": 1e3, "kn": 1e3, "pound_force": _POUND, "pound": _POUND,
              "lbf": _POUND, "lb": _POUND, "kilogram_force": 9.80665, "kg_force": 9.80665, "kgf": 9.80665},
    "ANGLE": {"radian": 1.0, "rad": 1.0, "degree": math.radians(1.0), "deg": math.radians(1.0)},
    "MASS": {"kilogram": 1.0, "kg": 1.0, "gram": 1e-3, "g": 1e-3, "tonne": 1e3, "ton": 1e3, "pound_mass": 0.45359237,
             "pound": 0.45359237, "lbm": 0.45359237, "lb": 0.45359237, "slug": 14.59390294},
    "TIME": {"second": 1.0, "sec": 1.0, "s": 1.0, "millisecond": 1e-3, "ms": 1e-3, "minute": 60.0, "hour": 3600.0},
    "PRESSURE": {"pascal": 1.0, "pa": 1.0, "kilopascal": 1e3, "kpa": 1e3, "megapascal": 1e6, "mpa": 1e6, "bar": 1e5,
                 "psi": _POUND / _INCH**2},
}  # fmt: skip
_VERSIONS: Final = {"5": "5.2", "6": "5.2", "51": "5.2", "52": "5.2", "60": "6.1", "61": "6.1", "62": "6.2"}
_OF_5_2: Final = ("PAC2002", "MF-TYRE", "MF_05", "MF52")  # formats of files without FITTYP
_MODES: Final = {3: False, 4: True, 5: True}  # last digit of USE_MODE, and whether slips combine
_NEEDED: Final = ["PCX1", "PDX1", "PKX1", "PCY1", "PDY1", "PKY1", "PKY2"]
_FOR_COMBINED: Final = ["RBX1", "RCX1", "RBY1", "RCY1"]
_POSITIVE: Final = (
    *("PDX1", "PKX1", "LFZO", "LCX", "LMUX", "LKX", "LCY", "LMUY", "LKY"),
    *("LONGITUDINAL_STIFFNESS", "LATERAL_STIFFNESS"),
)
_NOT_ZERO: Final = ["PDY1", "PKY1", "PKY2"]
_STEEPEST: Final = 1.55  # slip angle that counts as 90 deg [rad]
_LIGHTEST: Final = 1e-3  # share of the nominal load from which on the formulas count


class TyreFileOptions(Frozen):
    """What a vehicle file says of a tyre with a file of its own."""

    name: str = ""
    model: str
    file: str  # relative to the folder of the vehicle file
    tyres_per_wheel: int = quantity(1, "-", 1, 2, why="a wheel has one tyre or two, and counts as one")
    pressure: float | None = quantity(None, "Pa", 1e4, 5e6, why="truck tyres have 8e5 Pa")  # None: as in the file
    reference_friction: float = quantity(1.0, "-", 0.0, 2.0, above=True, why="ice has 0.05, rubber on asphalt 1")
    damping: float = quantity(0.04, "s", 0.0, 0.2, why="rubber has 0.001 s to 0.1 s")
    rolling_resistance: float | None = quantity(None, "-", 0.0, 0.3, why="0.005 to 0.01 on asphalt")
    relaxation_length: float | None = quantity(None, "m", 1e-3, 3.0, why="0.1 m to 1 m")


class _Entry(NamedTuple):
    section: str
    line: int
    value: str


class _PropertyFile:
    """Entries of a file by key, and its units."""

    def __init__(self, path: Path) -> None:
        self.path, self._entries = path, dict[str, _Entry]()
        self._units = {name: dict[str, float]() for name in _UNITS}
        content, section, header = read_bytes(path, FileKind.PARAMETERS), "", False
        units: dict[str, _Entry] = {}
        for number, line in enumerate(content.decode("latin-1").splitlines(), start=1):
            if match := _SECTION.match(line):
                section, header = match[1].upper(), True
            elif match := _KEY.match(line):
                entry = _Entry(section, number, match[2].strip().strip("'\"").strip())
                into, key = units if section == "UNITS" else self._entries, match[1].upper()
                if entry.value != into.setdefault(key, entry).value and into[key].section == section:
                    raise ValueError(f"{self._at(entry)}: {key} stands in line {into[key].line} with another value")
        if (
            not header
            or self.text("FILE_TYPE", "tir").lower() != "tir"
            or not {"FNOMIN", *_NEEDED} & set(self._entries)
        ):
            raise ValueError(f"{path}: is no tyre property file: no FILE_TYPE = 'tir' with coefficients in [SECTIONS]")
        self.unit = {name: self._unit(name, units.get(name)) for name in _UNITS}
        if "PRESSURE" not in units:
            self.unit["PRESSURE"] = self.unit["FORCE"] / self.unit["LENGTH"] ** 2

    def _at(self, entry: _Entry) -> str:
        return f"{self.path}: line {entry.line}, [{shown(entry.section, 40)}]"

    def _unit(self, name: str, entry: _Entry | None) -> float:
        if entry is None:
            return 1.0
        known, word = _UNITS[name], entry.value.lower()
        for spelt in (word, word.removesuffix("s").replace("metre", "meter"), word.replace("metre", "meter")):
            if spelt in known:
                return known[spelt]
        raise ValueError(f"{self._at(entry)}: {name} = '{shown(entry.value, 40)}' is no unit{nearest(word, known)}")

    def text(self, key: str, default: str) -> str:
        """Text of a key."""
        return self._entries[key].value if key in self._entries else default

    def refusal(self, key: str, message: str) -> ValueError:
        """A refusal that names the place of a key."""
        return ValueError(f"{self._at(self._entries[key])}: {key} = {shown(self.text(key, ''), 40)} {message}")

    def number(self, key: str, default: float | None, section: str = "", unit: float = 1.0) -> float:
        """Number of a key in SI units; required if it has no default, as a key of ``section``.

        Raises:
            ValueError: one line, if it is missing or no finite number.
        """
        if key not in self._entries or not self._entries[key].value:
            if default is None:
                raise ValueError(f"{self.path}: [{section}]: {key} is missing")
            return default
        try:
            value = float(re.sub("[dD]", "e", self._entries[key].value))
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self.refusal(key, "must be a finite number")
        if (key in _POSITIVE and value <= 0.0) or (key in _NOT_ZERO and value == 0.0):
            raise self.refusal(key, f"must {'be above' if key in _POSITIVE else 'not be'} 0")
        return value * unit

    def within(self, name: str, default: tuple[float, float], unit: float, zero: float) -> tuple[float, float]:
        """A range in SI units, which must contain ``zero``."""
        low, high = (
            self.number(name + end, value, unit=unit) for end, value in zip(("MIN", "MAX"), default, strict=True)
        )
        if not low <= zero <= high or low == high:
            key = name + ("MIN" if name + "MIN" in self._entries and low > zero else "MAX")
            raise self.refusal(key, f"leaves a range of {low:g} to {high:g} in SI units: it must contain {zero:g}")
        return low, high


def tyre_of_file(table: Mapping[str, Any], vehicle_file: str, key: str) -> PropertyFileTyre:
    """Tyre of a table that names a property file.

    Raises:
        ValueError: one line naming file, line, section, key and limit.
    """
    options = checked(TyreFileOptions, table, vehicle_file, key)
    path = Path(vehicle_file).parent / options.file
    if options.model != "magic_formula":
        raise ValueError(
            f"{vehicle_file}: {key}: a file of a tyre needs law = \"magic_formula\", not '{options.model}'"
        )
    file = _PropertyFile(path)
    version, combined = _version(path, file), _is_combined(file)
    count, unit = options.tyres_per_wheel, file.unit
    stiffness = unit["FORCE"] / unit["LENGTH"] * count
    needed = [*_NEEDED, *(_FOR_COMBINED if combined else ())]
    given = {
        name: file.number(name, None if name in needed else DEFAULTS[name], section,
                          stiffness if name in ("LONGITUDINAL_STIFFNESS", "LATERAL_STIFFNESS") else 1.0)
        for section, names in COEFFICIENTS.items() for name in names.split()
    }  # fmt: skip
    for name in ("PCX1", "PCY1"):
        if not 0.0 < given[name] * given[f"L{name[1:3]}"] <= 2.0:
            raise file.refusal(name, "with its scaling factor must be above 0 and at most 2: beyond, force turns round")
    side = file.text("TYRESIDE", "left").lower()
    if side not in ("left", "right", "symmetric"):
        raise file.refusal("TYRESIDE", "must be LEFT, RIGHT or SYMMETRIC")
    if file.number("USE_MODE", 14.0) < 0.0 and side != "symmetric":
        side = "left" if side == "right" else "right"
    if side == "symmetric":
        given |= dict.fromkeys((*ASYMMETRIES.split(), *(("QDZ3",) if version == "5.2" else ())), 0.0)
    nominal_load = file.number("FNOMIN", None, "VERTICAL", unit["FORCE"])
    if not 300.0 <= nominal_load <= 1e6:
        raise file.refusal("FNOMIN", f"is {nominal_load:g} N and must be between 300 and 1e+06 N")
    least, most = file.within("FZ", (0.0, 3.0 * nominal_load), unit["FORCE"], nominal_load)
    steepest = file.within("ALP", (-_STEEPEST, _STEEPEST), unit["ANGLE"], 0.0)
    fields = {
        "model": "tyre_file",
        "name": options.name,
        "version": version,
        "measured": side,
        "combined": combined,
        "reference_friction": options.reference_friction,
        "damping": options.damping,
        "rolling_resistance": _rolling_resistance(file, options),
        "radius": file.number("UNLOADED_RADIUS", None, "DIMENSION", unit["LENGTH"]),
        "reference_speed": file.number("LONGVL", 16.7, unit=unit["LENGTH"] / unit["TIME"]),
        "nominal_load": count * nominal_load,
        "loads": (count * max(least, _LIGHTEST * nominal_load), count * most),
        "slip_ratios": file.within("KPU", (-1.5, 1.5), 1.0, 0.0),
        "slip_angles": tuple(max(-_STEEPEST, min(_STEEPEST, angle)) for angle in steepest),
        "cambers": file.within("CAM", (-0.3, 0.3), unit["ANGLE"], 0.0),
        "coefficients": given,
        **_pressures(file, options, version),
    }
    return checked(PropertyFileTyre, fields | _lengths(path, file, options, fields), str(path))


def _version(path: Path, file: _PropertyFile) -> str:
    kind = file.text("FITTYP", "")
    if kind.removesuffix(".0") in _VERSIONS:
        return _VERSIONS[kind.removesuffix(".0")]
    form = file.text("PROPERTY_FILE_FORMAT", "")
    if not kind and form.upper() in _OF_5_2:
        return "5.2"
    read = "the Magic Formula 5.2, 6.1 and 6.2 are read: FITTYP 5, 6, 51, 52, 60, 61 or 62"
    if not kind and not form:
        raise ValueError(f"{path}: [MODEL]: FITTYP is missing: {read}")
    raise file.refusal("FITTYP" if kind else "PROPERTY_FILE_FORMAT", f"is another tyre model: {read}")


def _is_combined(file: _PropertyFile) -> bool:
    mode = int(abs(file.number("USE_MODE", 14.0))) % 10
    if mode not in _MODES:
        raise file.refusal("USE_MODE", "gives no forces in both directions: it must end with 3, 4 or 5")
    return _MODES[mode]


def _rolling_resistance(file: _PropertyFile, options: TyreFileOptions) -> float:
    if options.rolling_resistance is not None:
        return options.rolling_resistance
    return file.number("QSY1", None, "ROLLING_COEFFICIENTS") * file.number("LMY", 1.0)


def _pressures(file: _PropertyFile, options: TyreFileOptions, version: str) -> dict[str, float]:
    if version == "5.2":
        return {}
    unit = file.unit["PRESSURE"]
    nominal = file.number("NOMPRES", file.number("IP_NOM", 1.0, unit=unit), unit=unit)
    own = file.number("INFLPRES", file.number("IP", nominal, unit=unit), unit=unit)
    pressure = own if options.pressure is None else options.pressure
    low, high = (file.number(f"PRES{end}", value, unit=unit) for end, value in (("MIN", 0.0), ("MAX", math.inf)))
    check_number(f"{file.path}: pressure", pressure, low, high, "Pa", why="the range of the tyre file")
    return {"pressure": pressure, "nominal_pressure": nominal}


def _lengths(path: Path, file: _PropertyFile, options: TyreFileOptions, fields: Mapping[str, Any]) -> dict[str, Any]:
    """Relaxation lengths and pneumatic trail at the nominal load."""
    given = fields["coefficients"]
    along = across = options.relaxation_length
    by = "constant"
    has_stiffness = given["LONGITUDINAL_STIFFNESS"] and given["LATERAL_STIFFNESS"]
    if along is None:
        if given["PTX1"] and given["PTY1"] and given["PTY2"] and (fields["version"] == "5.2" or not has_stiffness):
            by = "coefficients"
        elif has_stiffness:
            by = "stiffness"
        else:
            unit = file.unit["LENGTH"]
            both = file.number("RELAXATION_LENGTH", 0.0, unit=unit)
            along, across = (file.number(f"REL_LEN_{end}", both, unit=unit) for end in ("LON", "LAT"))
            if not along or not across:
                raise ValueError(
                    f"{path}: [LATERAL_COEFFICIENTS]: PTX1, PTY1 and PTY2 are missing, and LONGITUDINAL_STIFFNESS and "
                    "LATERAL_STIFFNESS: give relaxation_length [m] beside the file in the vehicle file"
                )
    plain = {**fields, "coefficients": Coefficients(**given), "relaxes_by": by}
    lengths = PropertyFileTyre.model_construct(**plain).nominal_lengths()
    return {"relaxes_by": by, **lengths} | ({"along_relaxation": along, "relaxation_length": across} if along else {})
