"""Small FMUs, compiled from a few lines of C: a proportional law, a driver, a plant, and what can go wrong."""

import re
import shutil
import subprocess
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final, Literal, NamedTuple

from fmpy.fmi3 import FMU3Slave

TOKEN: Final = "{6c9f1d3e-0000-4000-8000-000000000001}"
STEP_MISHAPS: Final = ("crash", "endless", "nan", "error", "exit", "infinite", "discard", "fatal", "pending", "abort",
                       "success", "recursion", "killed", "closed", "chatter", "binary")  # fmt: skip
START_MISHAPS: Final = ("start crash", "start endless", "start nan", "start error", "start exit", "start discard")
END_MISHAPS: Final = ("end crash", "end endless")
MISHAPS: Final = {name: k for k, name in enumerate((*STEP_MISHAPS, *START_MISHAPS, *END_MISHAPS), start=1)}
"""Values of the parameter ``mishap``."""


class Quantity(NamedTuple):
    name: str
    causality: str
    unit: str = ""
    start: float = 0.0


MISHAP: Final = Quantity("mishap", "parameter")
AT: Final = Quantity("mishap_at", "parameter", "s")


def build_fmu(
    folder: Path,
    name: str,
    quantities: Sequence[Quantity],
    code: str,
    *,
    version: Literal[2, 3] = 2,
    keeps_state: bool = True,
    units: str = "",
) -> Path:
    """An FMU for co-simulation; ``code`` computes ``v[…]``, the variables in their order, and may keep ``x[…]``."""
    everything = (*quantities, MISHAP, AT)
    kinds, model = [one.causality for one in everything], Path(__file__).with_name("model.c")
    defines = {
        "VERSION": version,
        "N": len(everything),
        "TOKEN": f'"{TOKEN}"',
        "STARTS": ", ".join(repr(one.start) for one in everything),
        "MISHAP": len(quantities),
        "AT": len(quantities) + 1,
        "OUTPUT": kinds.index("output"),
        "CODE": " ".join(code.split()),
    }
    lines = [f"#define {key} {value}" for key, value in defines.items()] + [f'#include "{model}"']
    if version == 3:  # functions that importers look up, and nothing calls
        names = {name for name in dir(FMU3Slave) if re.fullmatch(r"fmi3[A-Z]\w+", name)}
        lines += [f"UNUSED({name})" for name in sorted(names - set(re.findall(r"\w+", model.read_text())))]
    source, library, path = (folder / f"{name}{suffix}" for suffix in (".c", ".so", ".fmu"))
    source.write_text("\n".join(lines) + "\n", encoding="utf-8")
    compiler = shutil.which("cc") or "gcc"
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-w", "-o", str(library), str(source)], check=True)
    text = description(name, everything, keeps_state=keeps_state, units=units)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text if version == 2 else description_3(name, everything))
        archive.write(library, f"binaries/{'linux64' if version == 2 else 'x86_64-linux'}/{name}.so")
    return path


def _attributes(reference: int, one: Quantity) -> tuple[str, str]:
    """Attributes of a variable, and of its type."""
    fixed = ' variability="fixed"' if one.causality == "parameter" else ""
    start = f' start="{one.start!r}"' if one.causality != "output" else ""
    unit = f' unit="{one.unit}"' if one.unit else ""
    return f'name="{one.name}" valueReference="{reference}" causality="{one.causality}"{fixed}', unit + start


def description(name: str, quantities: Sequence[Quantity], *, keeps_state: bool = True, units: str = "") -> str:
    rows = (_attributes(k, one) for k, one in enumerate(quantities))
    variables = "".join(f"<ScalarVariable {whose}><Real{kind}/></ScalarVariable>" for whose, kind in rows)
    outputs = "".join(f'<Unknown index="{k}"/>' for k, one in enumerate(quantities, 1) if one.causality == "output")
    state = str(keeps_state).lower()
    return (
        '<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="2.0" '
        f'modelName="{name}" guid="{TOKEN}"><CoSimulation modelIdentifier="{name}" canGetAndSetFMUstate="{state}" '
        f'canSerializeFMUstate="{state}" canHandleVariableCommunicationStepSize="true"/>'
        f"{units}<ModelVariables>{variables}</ModelVariables>"
        f"<ModelStructure><Outputs>{outputs}</Outputs></ModelStructure></fmiModelDescription>"
    )


def description_3(name: str, quantities: Sequence[Quantity]) -> str:
    rows = (_attributes(k, one) for k, one in enumerate(quantities))
    variables = "".join(f"<Float64 {whose}{kind}/>" for whose, kind in rows)
    outputs = "".join(
        f'<Output valueReference="{k}"/>' for k, one in enumerate(quantities) if one.causality == "output"
    )
    return (
        '<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="3.0" '
        f'modelName="{name}" instantiationToken="{TOKEN}"><CoSimulation modelIdentifier="{name}" '
        'canGetAndSetFMUState="true" canSerializeFMUState="true" canHandleVariableCommunicationStepSize="true"/>'
        '<ModelVariables><Float64 name="time" valueReference="1000" causality="independent" variability="continuous"/>'
        f"{variables}</ModelVariables><ModelStructure>{outputs}</ModelStructure></fmiModelDescription>"
    )


LAW: Final = (
    Quantity("off_tracking", "input", "m"),
    Quantity("steer_demand_1", "output", "rad"),
    Quantity("steer_demand_2", "output", "rad"),
    Quantity("gain", "parameter", "rad/m", 0.2),
)
LAW_CODE: Final = "v[1] = v[2] = v[3] * v[0];"


def proportional_law(folder: Path) -> Path:
    """The law of docs/tutorials/own-law.md for a trailer with two steered axles, without its limit."""
    return build_fmu(folder, "law", LAW, LAW_CODE)


DRIVER: Final = (
    Quantity("ahead_x_10", "input", "m"),
    Quantity("ahead_y_10", "input", "m"),
    Quantity("steer", "output", "rad"),
)
DRIVER_CODE: Final = "v[2] = atan2(2 * 3.8 * v[1], v[0] * v[0] + v[1] * v[1]);"  # pure pursuit, wheelbase 3.8 m


def pursuit_driver(folder: Path) -> Path:
    """A driver who steers for the point of the path that is 10 m ahead of the guided one."""
    return build_fmu(folder, "pursuit", DRIVER, DRIVER_CODE)


_PLANT_IN: Final = (
    Quantity("delta", "input", "deg"),
    Quantity("a", "input"),
    Quantity("v0", "parameter", "", 1.0),
    Quantity("hitch", "parameter", "m", 0.6),
    Quantity("length", "parameter", "m", 8.0),
)
_PLANT_OUT: Final = tuple(
    Quantity(f"unit{k}.{name}", "output", "deg" if name == "psi" else "m") for k in (1, 2) for name in ("x", "y", "psi")
)
PLANT: Final = (*_PLANT_IN, *_PLANT_OUT)
PLANT_CODE: Final = """
    const double deg = 57.29577951308232, n = 20;
    if (x[5] == 0) { x[4] = v[2]; x[5] = 1; }
    for (int i = 0; i < n; i++) {
        double h = dt / n, w = x[4] * tan(v[0] / deg) / 3.8, phi = x[2] - x[3];
        double across = x[4] * sin(phi) + v[3] * w * cos(phi);
        x[0] += h * x[4] * cos(x[2]), x[1] += h * x[4] * sin(x[2]), x[2] += h * w, x[3] += h * across / v[4];
        x[4] += h * v[1];
    }
    v[5] = x[0], v[6] = x[1], v[7] = x[2] * deg;
    v[8] = x[0] + v[3] * cos(x[2]), v[9] = x[1] + v[3] * sin(x[2]), v[10] = x[3] * deg;
"""  # a tractor of 3.8 m wheelbase and a trailer that roll without slip
PLANT_MAP: Final = """
part = "plant.fmu"
period = 0.01

[inputs]
delta = "steer"
a = "acceleration"

[outputs]
"unit1.x" = "x_1"
"unit1.y" = "y_1"
"unit1.psi" = { signal = "psi_1", unit = "deg" }
"unit2.x" = "x_2"
"unit2.y" = "y_2"
"unit2.psi" = { signal = "psi_2", unit = "deg" }

[parameters]
v0 = "start_speed"
hitch = %r
length = %r
"""


def rolling_plant(folder: Path, hitch: float, length: float) -> Path:
    """A tractor and a trailer that roll without slip, with its map."""
    path = build_fmu(folder, "rolling", PLANT, PLANT_CODE)
    path.with_name("rolling.fmu.toml").write_text(PLANT_MAP % (hitch, length), encoding="utf-8")
    return path
