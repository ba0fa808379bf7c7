"""First map of an FMU: what its names and units suggest, for a user to go on with."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

from scenarios.fmi_import.archive import FmuFile, Variable
from scenarios.fmi_import.mapping import PERIOD, TIMEOUT, PartSignals, Signal, of_causality
from scenarios.fmi_import.units import declared_scale, fits

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
