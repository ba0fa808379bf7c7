"""Small FMUs, compiled from a few lines of C: a proportional law, a driver, a plant, and what can go wrong."""

from __future__ import annotations

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

_MODEL: Final = """
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <stdio.h>
#include <signal.h>
#include <unistd.h>
#define N %(count)d
#define TOKEN "%(token)s"
typedef struct { double v[N]; double x[16]; } Model;
static double starts[N] = { %(starts)s };
static double deep(double x) {
    volatile char filled[4096];
    filled[0] = (char)x;
    return deep(x + filled[0]) + filled[0];
}
static void ended(Model *m) {
    if (m->v[%(mishap)d] == 23) *(volatile int *)8 = 1;
    if (m->v[%(mishap)d] == 24) for (;;) usleep(1000);
    free(m);
}
static int computed(Model *m, double time, double dt) {
    double *v = m->v, *x = m->x;
    (void)x;
    (void)dt;
    const int due = dt > 0 && time >= v[%(at)d] - 1e-9, mishap = (int)v[%(mishap)d];
    if (due) switch (mishap) {
        case 1: *(volatile int *)8 = 1; break;
        case 2: for (;;) usleep(1000);
        case 3: v[%(first_output)d] = NAN; return 0;
        case 4: fprintf(stderr, "the water is too cold\\n"); return 3;
        case 5: exit(7);
        case 6: v[%(first_output)d] = INFINITY; return 0;
        case 7: return 2;
        case 8: return 4;
        case 9: return 5;
        case 10: abort();
        case 11: exit(0);
        case 12: return (int)deep(1.0);
        case 13: kill(getpid(), SIGKILL);
        case 14: for (int k = 0; k < 64; k++) close(k); for (;;) usleep(1000);
        case 15: for (int k = 0; k < 20000; k++) printf("blah %%d\\n", k); fflush(stdout); return 3;
        case 16: for (int k = 0; k < 256; k++) fputc(k, stderr); return 3;
    }
    if (dt == 0) switch (mishap) {
        case 17: *(volatile int *)8 = 1; break;
        case 18: for (;;) usleep(1000);
        case 19: v[%(first_output)d] = NAN; return 0;
        case 20: return 3;
        case 21: exit(9);
        case 22: return 2;
    }
    %(code)s
    return 0;
}
"""
_FMI2: Final = """
void *fmi2Instantiate(const char *n, int t, const char *g, const char *r, void *c, int vis, int log) {
    if (strcmp(g, TOKEN)) return 0;
    Model *m = calloc(1, sizeof(Model));
    memcpy(m->v, starts, sizeof starts);
    return m;
}
void fmi2FreeInstance(void *m) { ended(m); }
int fmi2SetupExperiment(void *m, int a, double b, double c, int d, double e) { return 0; }
int fmi2EnterInitializationMode(void *m) { return 0; }
int fmi2ExitInitializationMode(void *m) { return computed(m, 0, 0); }
int fmi2Terminate(void *m) { return 0; }
int fmi2SetReal(void *m, const unsigned *r, size_t n, const double *v) {
    for (size_t i = 0; i < n; i++) ((Model *)m)->v[r[i]] = v[i];
    return 0;
}
int fmi2GetReal(void *m, const unsigned *r, size_t n, double *v) {
    for (size_t i = 0; i < n; i++) v[i] = ((Model *)m)->v[r[i]];
    return 0;
}
#define UNUSED(name) int name(void) { return 3; }
UNUSED(fmi2GetTypesPlatform) UNUSED(fmi2GetVersion) UNUSED(fmi2SetDebugLogging) UNUSED(fmi2Reset)
UNUSED(fmi2GetInteger) UNUSED(fmi2GetBoolean) UNUSED(fmi2GetString) UNUSED(fmi2SetInteger) UNUSED(fmi2SetBoolean)
UNUSED(fmi2SetString) UNUSED(fmi2GetDirectionalDerivative) UNUSED(fmi2SetRealInputDerivatives)
UNUSED(fmi2GetRealOutputDerivatives) UNUSED(fmi2CancelStep) UNUSED(fmi2GetStatus) UNUSED(fmi2GetRealStatus)
UNUSED(fmi2GetIntegerStatus) UNUSED(fmi2GetBooleanStatus) UNUSED(fmi2GetStringStatus)
int fmi2DoStep(void *m, double t, double h, int k) { return computed(m, t, h); }
int fmi2GetFMUstate(void *m, void **s) { *s = malloc(sizeof(Model)); memcpy(*s, m, sizeof(Model)); return 0; }
int fmi2SetFMUstate(void *m, void *s) { memcpy(m, s, sizeof(Model)); return 0; }
int fmi2FreeFMUstate(void *m, void **s) { free(*s); *s = 0; return 0; }
int fmi2SerializedFMUstateSize(void *m, void *s, size_t *n) { *n = sizeof(Model); return 0; }
int fmi2SerializeFMUstate(void *m, void *s, char *b, size_t n) { memcpy(b, s, n); return 0; }
int fmi2DeSerializeFMUstate(void *m, const char *b, size_t n, void **s) { *s = malloc(n); memcpy(*s, b, n); return 0; }
"""
_FMI3: Final = """
#include <stdbool.h>
void *fmi3InstantiateCoSimulation(const char *n, const char *t, const char *r, bool v, bool l, bool e, bool a,
                                  const unsigned *q, size_t nq, void *env, void *log, void *update) {
    Model *m = calloc(1, sizeof(Model));
    memcpy(m->v, starts, sizeof starts);
    return m;
}
void fmi3FreeInstance(void *m) { ended(m); }
int fmi3EnterInitializationMode(void *m, bool a, double b, double c, bool d, double e) { return 0; }
int fmi3ExitInitializationMode(void *m) { return computed(m, 0, 0); }
int fmi3Terminate(void *m) { return 0; }
int fmi3SetFloat64(void *m, const unsigned *r, size_t n, const double *v, size_t nv) {
    for (size_t i = 0; i < n; i++) ((Model *)m)->v[r[i]] = v[i];
    return 0;
}
int fmi3GetFloat64(void *m, const unsigned *r, size_t n, double *v, size_t nv) {
    for (size_t i = 0; i < n; i++) v[i] = ((Model *)m)->v[r[i]];
    return 0;
}
int fmi3DoStep(void *m, double t, double h, bool k, bool *event, bool *end, bool *early, double *last) {
    *event = *end = *early = false;
    *last = t + h;
    return computed(m, t, h);
}
int fmi3GetFMUState(void *m, void **s) { *s = malloc(sizeof(Model)); memcpy(*s, m, sizeof(Model)); return 0; }
int fmi3SetFMUState(void *m, void *s) { memcpy(m, s, sizeof(Model)); return 0; }
int fmi3FreeFMUState(void *m, void **s) { free(*s); *s = 0; return 0; }
int fmi3SerializedFMUStateSize(void *m, void *s, size_t *n) { *n = sizeof(Model); return 0; }
int fmi3SerializeFMUState(void *m, void *s, char *b, size_t n) { memcpy(b, s, n); return 0; }
int fmi3DeserializeFMUState(void *m, const char *b, size_t n, void **s) { *s = malloc(n); memcpy(*s, b, n); return 0; }
#define UNUSED(name) int name(void) { return 3; }
"""


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
    names = [one.name for one in everything]
    source = folder / f"{name}.c"
    source.write_text(
        _MODEL
        % {
            "count": len(everything),
            "token": TOKEN,
            "starts": ", ".join(repr(one.start) for one in everything),
            "mishap": names.index("mishap"),
            "at": names.index("mishap_at"),
            "first_output": next(k for k, one in enumerate(everything) if one.causality == "output"),
            "code": code,
        }
        + (_FMI2 if version == 2 else _FMI3 + _unused(_FMI3)),
        encoding="utf-8",
    )
    library = folder / f"{name}.so"
    compiler = shutil.which("cc") or "gcc"
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-w", "-o", str(library), str(source)], check=True)
    path = folder / f"{name}.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        if version == 2:
            archive.writestr(
                "modelDescription.xml", description(name, everything, keeps_state=keeps_state, units=units)
            )
            archive.write(library, f"binaries/linux64/{name}.so")
        else:
            archive.writestr("modelDescription.xml", description_3(name, everything))
            archive.write(library, f"binaries/x86_64-linux/{name}.so")
    return path


def _unused(source: str) -> str:
    names = [name for name in dir(FMU3Slave) if re.fullmatch(r"fmi3[A-Z]\w+", name) and f" {name}(" not in source]
    return "\n".join(f"UNUSED({name})" for name in names if f"*{name}(" not in source)


def description(name: str, quantities: Sequence[Quantity], *, keeps_state: bool = True, units: str = "") -> str:
    rows, outputs = [], []
    for k, one in enumerate(quantities):
        unit = f' unit="{one.unit}"' if one.unit else ""
        fixed = ' variability="fixed"' if one.causality == "parameter" else ""
        start = f' start="{one.start!r}"' if one.causality != "output" else ""
        rows.append(
            f'<ScalarVariable name="{one.name}" valueReference="{k}" causality="{one.causality}"{fixed}>'
            f"<Real{unit}{start}/></ScalarVariable>"
        )
        if one.causality == "output":
            outputs.append(f'<Unknown index="{k + 1}"/>')
    state = str(keeps_state).lower()
    return (
        '<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="2.0" '
        f'modelName="{name}" guid="{TOKEN}"><CoSimulation modelIdentifier="{name}" canGetAndSetFMUstate="{state}" '
        f'canSerializeFMUstate="{state}" canHandleVariableCommunicationStepSize="true"/>'
        f"{units}<ModelVariables>{''.join(rows)}</ModelVariables>"
        f"<ModelStructure><Outputs>{''.join(outputs)}</Outputs></ModelStructure></fmiModelDescription>"
    )


def description_3(name: str, quantities: Sequence[Quantity]) -> str:
    rows = ['<Float64 name="time" valueReference="1000" causality="independent" variability="continuous"/>']
    outputs = []
    for k, one in enumerate(quantities):
        fixed = ' variability="fixed"' if one.causality == "parameter" else ""
        start = f' start="{one.start!r}"' if one.causality != "output" else ""
        unit = f' unit="{one.unit}"' if one.unit else ""
        rows.append(
            f'<Float64 name="{one.name}" valueReference="{k}" causality="{one.causality}"{fixed}{unit}{start}/>'
        )
        if one.causality == "output":
            outputs.append(f'<Output valueReference="{k}"/>')
    return (
        '<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="3.0" '
        f'modelName="{name}" instantiationToken="{TOKEN}"><CoSimulation modelIdentifier="{name}" '
        'canGetAndSetFMUState="true" canSerializeFMUState="true" canHandleVariableCommunicationStepSize="true"/>'
        f"<ModelVariables>{''.join(rows)}</ModelVariables><ModelStructure>{''.join(outputs)}</ModelStructure>"
        "</fmiModelDescription>"
    )


LAW: Final = (
    Quantity("off_tracking", "input", "m"),
    Quantity("steer_demand_1", "output", "rad"),
    Quantity("steer_demand_2", "output", "rad"),
    Quantity("gain", "parameter", "rad/m", 0.2),
)
LAW_CODE: Final = "v[1] = v[2] = v[3] * v[0];"


def proportional_law(folder: Path) -> Path:
    """The law of docs/own-parts.md for a trailer with two steered axles, without its limit."""
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
