"""Maps between the variables of an FMU and offtrack's signals: TOML files beside FMUs, and a first map to edit."""

import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

from offtrack.exchange.fmi_import.fmu_file import UNITS, FmuFile, Scale, Variable, declared_scale, fits
from scenarios.results.run_inputs import MAP_SUFFIX
from vehicle.clock import TICK
from vehicle.foundation.user_file import FileKind, nearest, read_toml, shown

PERIOD: Final = 0.01  # of a step, where neither map nor FMU says [s]
TIMEOUT: Final = 10.0  # longest time that a step may take [s]
_TABLES: Final = ("inputs", "outputs", "parameters")
_NUMBERS: Final = ("period", "timeout")
_LINK: Final = ("signal", "unit", "factor", "offset")


class Signal(NamedTuple):
    """A number that goes into an FMU or comes out."""

    name: str
    unit: str  # SI, "-" for none
    meaning: str
    start: float = 0.0  # of a parameter or input of an exported FMU
    low: float | None = None  # limits that the exporter declares; the FMU does not enforce them
    high: float | None = None
    required: bool = False  # an output of an imported FMU that the part can't do without
    instead: tuple[str, ...] = ()  # others that do as well


def numbered(name: str, unit: str, meanings: Iterable[str], start: float = 0.0) -> list[Signal]:
    """Signals of one kind, counted from 1: ``name_1``, ``name_2``, ..."""
    return [Signal(f"{name}_{k}", unit, meaning, start) for k, meaning in enumerate(meanings, start=1)]


@dataclass(frozen=True, slots=True, kw_only=True)
class PartSignals:
    """Signals of a kind of part."""

    kind: str  # key of the scenario, such as trailer_steering
    inputs: tuple[Signal, ...]  # of the FMU
    outputs: tuple[Signal, ...]
    starts: tuple[Signal, ...] = ()  # values at the start, which parameters can take


class Link(NamedTuple):
    """A variable and its signal: value of the variable = gain * signal [SI] + shift, or the other way for an output."""

    variable: Variable
    signal: str
    gain: float
    shift: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FmuMap:
    """How an FMU is connected."""

    inputs: tuple[Link, ...]
    outputs: tuple[Link, ...]
    parameters: Mapping[str, float | str]
    starts: tuple[Link, ...]  # of parameters
    period: int  # of its steps [ticks]
    timeout: float  # longest time that a step may take [s]

    def values(self, signals: Mapping[str, float]) -> list[float]:
        """Values of the input variables."""
        return [gain * signals[signal] + shift for _, signal, gain, shift in self.inputs]

    def start_values(self, signals: Mapping[str, float]) -> dict[str, float]:
        """Values of the parameters that take signals of the start."""
        return {link.variable.name: link.gain * signals[link.signal] + link.shift for link in self.starts}

    def signals(self, values: Sequence[float]) -> dict[str, float]:
        """Signals [SI] from the values of the output variables."""
        links = zip(self.outputs, values, strict=True)
        return {signal: gain * value + shift for (_, signal, gain, shift), value in links}


def map_file(fmu: Path) -> Path:
    """Place of the map of an FMU: its name with ``.toml`` after it."""
    return fmu.with_name(fmu.name + MAP_SUFFIX)


def read_map(fmu: FmuFile, part: PartSignals) -> FmuMap:
    """The map beside an FMU; without it, or without its inputs and outputs, names decide.

    Raises:
        ValueError: one line with the file, the place and what is wrong there.
    """
    path = map_file(fmu.path)
    given = os.path.lexists(path)
    table = read_toml(path, FileKind.PARAMETERS) if given else {}
    if not {"inputs", "outputs"} & table.keys():
        table = {**_by_names(fmu, part), **table}
    source = path if given else fmu.path
    for key in table:
        if key not in (*_TABLES, *_NUMBERS, "part"):
            raise ValueError(f"{source}: unknown key '{shown(key)}'{nearest(key, (*_TABLES, *_NUMBERS, 'part'))}")
    if table.get("part", part.kind) != part.kind:
        raise ValueError(f"{source}: part = {table['part']!r}: this FMU is used as {part.kind}")
    inputs = tuple(_links(source, fmu, part, table, "inputs"))
    outputs = tuple(_links(source, fmu, part, table, "outputs"))
    _check_outputs(fmu, part, outputs)
    return FmuMap(
        inputs=inputs,
        outputs=outputs,
        parameters=_parameters(source, fmu, _subtable(source, table, "parameters")),
        starts=tuple(_links(source, fmu, part, table, "parameters")),
        period=_period(source, fmu, table),
        timeout=_positive(source, table, "timeout", TIMEOUT),
    )


def _by_names(fmu: FmuFile, part: PartSignals) -> dict[str, Any]:
    return {
        name: {
            variable.name: variable.name
            for variable in of_causality(fmu, name)
            if any(variable.name == signal.name for signal in signals)
        }
        for name, signals in (("inputs", part.inputs), ("outputs", part.outputs), ("parameters", part.starts))
    }


def of_causality(fmu: FmuFile, table: str) -> list[Variable]:
    """Variables that are numbers and belong into a table of a map: inputs, outputs or parameters."""
    causality = table.removesuffix("s")
    return [one for one in fmu.variables.values() if one.causality == causality and one.is_number]


def _links(source: Path, fmu: FmuFile, part: PartSignals, table: Mapping[str, Any], name: str) -> list[Link]:
    of_table = {"inputs": part.inputs, "outputs": part.outputs, "parameters": part.starts}
    signals = {signal.name: signal for signal in of_table[name]}
    links = []
    for key, value in _subtable(source, table, name).items():
        if name == "parameters" and (isinstance(value, int | float) or _is_text(fmu, key)):
            continue  # a plain value
        place = f"{source}: {name}.{shown(key, 60)}"
        link = value if isinstance(value, dict) else {"signal": value}
        named = link.get("signal")
        several: list[Any] = named if isinstance(named, list) and name == "outputs" else [named]
        if not several or not all(isinstance(one, str) for one in several):
            wanted = "signals" if name == "outputs" else "a signal"
            raise ValueError(f"{place} = {shown(repr(value), 60)}: must be the name of {wanted}, or a table with one")
        for word in link:
            if word not in _LINK:
                raise ValueError(f"{place}: unknown key '{shown(word)}'{nearest(word, _LINK)}")
        variable = _variable(place, fmu, key, name.removesuffix("s"))
        for one in several:
            if one not in signals:
                raise ValueError(f"{place}: {part.kind} has no signal '{shown(one)}'{nearest(one, tuple(signals))}")
            links.append(_link(place, variable, signals[one], link, into=name != "outputs"))
    repeated = [link.signal for k, link in enumerate(links) if any(link.signal == one.signal for one in links[:k])]
    if name == "outputs" and repeated:
        raise ValueError(f"{source}: outputs: two variables give the signal {repeated[0]}")
    return links


def _variable(place: str, fmu: FmuFile, name: str, causality: str) -> Variable:
    variable = fmu.variables.get(name)
    if variable is None:
        raise ValueError(f"{place}: the FMU has no variable '{shown(name, 60)}'{nearest(name, tuple(fmu.variables))}")
    if variable.causality != causality:
        raise ValueError(f"{place}: is of causality '{variable.causality}' in the FMU: must be '{causality}'")
    if not variable.is_number:
        raise ValueError(f"{place}: is of type {variable.kind}: must be a number")
    return variable


def _link(place: str, variable: Variable, signal: Signal, link: Mapping[str, Any], *, into: bool) -> Link:
    unit = link.get("unit")
    if unit is not None and unit not in UNITS:
        raise ValueError(f"{place}: unit = {unit!r}{nearest(str(unit), tuple(UNITS))}")
    scale = declared_scale(variable) if unit is None else UNITS[unit]
    if scale is None and variable.unit:
        raise ValueError(
            f"{place}: the FMU's unit '{shown(variable.unit, 40)}' is none of a signal; the signal {signal.name} is in "
            f'{signal.unit}: give the variable\'s unit in the map, such as unit = "{signal.unit}"'
        )
    scale = scale or Scale(signal.unit)
    if not fits(scale, signal.unit):
        raise ValueError(
            f"{place}: the variable is in {unit or variable.unit}, the signal {signal.name} in {signal.unit}: "
            'give the variable\'s unit, such as unit = "deg"'
        )
    factor, offset = (_finite(place, link, word, default) for word, default in (("factor", 1.0), ("offset", 0.0)))
    if into:  # in the unit, then scaled
        return Link(variable, signal.name, factor / scale.factor, offset - factor * scale.offset / scale.factor)
    return Link(variable, signal.name, factor * scale.factor, scale.factor * offset + scale.offset)


def _check_outputs(fmu: FmuFile, part: PartSignals, outputs: Sequence[Link]) -> None:
    given = {link.signal for link in outputs}
    missing = [one.name for one in part.outputs if one.required and not given & {one.name, *one.instead}]
    if missing:
        raise ValueError(
            f"{fmu.path}: no variable is connected to {part.kind}'s signal {', '.join(missing)}: write them into "
            f"{map_file(fmu.path).name} (offtrack fmu map {fmu.path.name} writes a first one)"
        )


def _is_text(fmu: FmuFile, name: str) -> bool:
    return name in fmu.variables and fmu.variables[name].kind == "String"


def _parameters(source: Path, fmu: FmuFile, given: Mapping[str, Any]) -> dict[str, float | str]:
    values: dict[str, float | str] = {}
    for name in given:
        if _is_text(fmu, name) and isinstance(given[name], str):
            values[name] = given[name]
            continue
        if not isinstance(given[name], int | float):
            continue  # a signal of the start
        place = f"{source}: parameters.{shown(name, 60)}"
        variable = _variable(place, fmu, name, "parameter")
        value = _finite(place, given, name, 0.0)
        if not (-math.inf if variable.low is None else variable.low) <= value <= (variable.high or math.inf):
            raise ValueError(f"{place} = {value:g}: must be {variable.low} to {variable.high} {variable.unit}")
        values[name] = value
    return values


def _subtable(source: Path, table: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    inside = table.get(name, {})
    if not isinstance(inside, dict):
        raise ValueError(f"{source}: {name} must be a table")
    return inside


def _period(source: Path, fmu: FmuFile, table: Mapping[str, Any]) -> int:
    period = _positive(source, table, "period", fmu.step or PERIOD)
    ticks = round(period / TICK)
    if ticks < 1 or abs(ticks * TICK - period) > 1e-9:
        raise ValueError(f"{source}: period = {period:g} s must be a whole number of milliseconds")
    if fmu.fixed_step and fmu.step is not None and abs(round(period / fmu.step) * fmu.step - period) > 1e-9:
        raise ValueError(f"{source}: period = {period:g} s: the FMU accepts only multiples of {fmu.step:g} s")
    return ticks


def _positive(source: Path, table: Mapping[str, Any], name: str, default: float) -> float:
    value = _finite(str(source), table, name, default)
    if not value > 0.0:
        raise ValueError(f"{source}: {name} = {value:g} must be positive")
    return value


def _finite(place: str, table: Mapping[str, Any], name: str, default: float) -> float:
    value = table.get(name, default)
    if isinstance(value, bool):
        return float(value)
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{place}: {name} = {shown(repr(value), 40)} must be a finite number")
    return float(value)


_LONG_ROW: Final = 100  # of numbered signals, which a first map does not list one by one
_ALIKE: Final = 0.6  # share of the words that two names have in common, which a first map proposes
_SAME: Final = {
    "unit": "",
    "body": "",
    "delta": "steer",
    "steering": "steer",
    "a": "acceleration",
    "acc": "acceleration",
    "v": "speed",
    "velocity": "speed",
    "vx": "v_x",
    "vy": "v_y",
    "yaw": "psi",
    "heading": "psi",
    "yawrate": "yaw_rate",
    "phi": "articulation",
    "gamma": "articulation",
    "offtracking": "off_tracking",
    "mu": "friction",
    "t": "time",
}  # words that mean the same; those of a signal's own name come out of both alike


def first_map(fmu: FmuFile, part: PartSignals) -> str:
    """Text of a first map, by names and units, with all other variables and signals as comments."""
    lines = [
        f"# Map of {fmu.path.name} as {part.kind}: variable of the FMU = signal of offtrack.",
        '# A link may be a table: { signal = "speed", unit = "km/h", factor = -1.0, offset = 0.0 };',
        "# value in the unit = factor * signal + offset for inputs, signal = factor * value + offset for outputs.",
        f'part = "{part.kind}"',
        f"period = {fmu.step or PERIOD:g}  # of its steps [s], a whole number of milliseconds",
        f"timeout = {TIMEOUT:g}  # longest time that a step may take [s]",
    ]
    for name, signals in (("inputs", part.inputs), ("outputs", part.outputs)):
        lines += ["", f"[{name}]"]
        left, names = list(signals), {variable.name for variable in of_causality(fmu, name)}
        for variable in of_causality(fmu, name):
            chosen = next((one for one in left if one.name == variable.name), None) or _likely(
                variable, [one for one in left if one.name not in names]
            )
            unit = f" [{variable.unit}]" if variable.unit else ""
            meaning = f"  # {' '.join(variable.meaning.split())}{unit}" if variable.meaning or unit else ""
            if chosen is None:
                lines.append(f'# "{variable.name}" = ""{meaning}')
            else:
                left.remove(chosen)
                lines.append(f'"{variable.name}" = "{chosen.name}"{meaning}')
        lines += _listed(left)
    parameters = of_causality(fmu, "parameters")
    starts = {one.name for one in part.starts} & {one.name for one in parameters}
    lines += ["", "[parameters]", *(f'"{name}" = "{name}"' for name in sorted(starts))]
    lines += [f'# "{one.name}" = {one.start or "0"}  # {one.meaning}' for one in parameters if one.name not in starts]
    lines += [f'# "{one.name}" = "{one.start or ""}"  # {one.meaning}' for one in fmu.variables.values()
              if one.kind == "String" and one.causality == "parameter"]  # fmt: skip
    lines += [f'# "…" = "{one.name}"  # {one.meaning} [{one.unit}]' for one in part.starts if one.name not in starts]
    return "\n".join(lines) + "\n"


def _listed(signals: Sequence[Signal]) -> list[str]:
    """Comments on signals; of a long numbered row the first and the last."""
    rows: dict[str, list[Signal]] = {}
    for one in signals:
        rows.setdefault(one.name.rstrip("0123456789"), []).append(one)
    shown_ones = [row if len(row) <= _LONG_ROW else [row[0], row[-1]] for row in rows.values()]
    return [f"# signal {one.name} [{one.unit}]: {one.meaning}" for row in shown_ones for one in row]


def _likely(variable: Variable, signals: Sequence[Signal]) -> Signal | None:
    """The signal of a fitting unit whose name has most words in common with a variable's, if it is the only one."""
    scale = declared_scale(variable)
    if scale is None and variable.unit:
        return None
    fitting = [signal for signal in signals if scale is None or fits(scale, signal.unit)]
    likeness = {signal: _likeness(_words(variable.name), _words(signal.name)) for signal in fitting}
    best = max(likeness.values(), default=0.0)
    found = [signal for signal, value in likeness.items() if value == best]
    return found[0] if best >= _ALIKE and len(found) == 1 else None


def _words(name: str) -> frozenset[str]:
    words = (_SAME.get(word, word) for word in re.findall(r"[a-z]+|\d+", name.lower()))
    return frozenset(part for word in words for part in word.split("_") if part)


def _likeness(one: frozenset[str], other: frozenset[str]) -> float:
    return len(one & other) / max(1, len(one | other))
