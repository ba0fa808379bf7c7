"""FMUs driven by `host.c`, a host that is no Python: on this machine, and compiled for Windows under Wine."""

import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import fmpy
import numpy as np

from offtrack.exchange.fmi_export.plant_model import headers_folder
from tests.fmus.plants import STEP, c_compiler
from vehicle.frames import FloatArray

_HEADERS: Final = headers_folder()
_SOURCE: Final = Path(__file__).with_name("host.c")
_FOLDERS: Final = {"linux64": ("linux64", "x86_64-linux", ".so"), "win64": ("win64", "x86_64-windows", ".dll")}
HAS_ZIG: Final = importlib.util.find_spec("ziglang") is not None


def wine() -> str | None:
    return shutil.which("wine64") or shutil.which("wine") or shutil.which("wine64", path="/usr/lib/wine")


def compiled_for_windows(source: Path, folder: Path) -> Path:
    """A C program of one file as a program for Windows, by Zig's compiler."""
    program = folder / f"{source.stem}.exe"
    command = [sys.executable, "-m", "ziglang", "cc", "-target", "x86_64-windows-gnu", "-w", f"-I{_HEADERS}"]
    environment = {**os.environ, "ZIG_LOCAL_CACHE_DIR": str(folder / "zig")}
    subprocess.run([*command, str(source), "-o", str(program)], check=True, env=environment)
    return program


def compiled_by_fmpy(fmu: Path) -> None:
    """FMPy compiles an FMU's library from its sources."""
    done = subprocess.run([sys.executable, "-m", "fmpy", "compile", str(fmu)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@dataclass(frozen=True, kw_only=True)
class Host:
    command: Sequence[str]
    platform: str = "linux64"
    environment: Mapping[str, str] = field(default_factory=dict)

    def run(
        self,
        fmu: Path,
        folder: Path,
        *,
        rows: Mapping[str, Sequence[float] | FloatArray],
        outputs: Sequence[str],
        starts: Mapping[str, float] | None = None,
        texts: Mapping[str, str] | None = None,
    ) -> subprocess.CompletedProcess[str]:
        """Drive an FMU through rows of inputs by name, in steps of 10 ms; it is unpacked into the folder.

        ``np.loadtxt`` reads the outputs from its standard output: before the first and after every step.
        """
        description = fmpy.read_model_description(str(fmu))
        if not folder.exists():
            fmpy.extract(str(fmu), str(folder))
        reference = {one.name: one.valueReference for one in description.modelVariables}
        is_2 = description.fmiVersion == "2.0"
        of_2, of_3, suffix = _FOLDERS[self.platform]
        library = folder / "binaries" / (of_2 if is_2 else of_3) / f"{description.coSimulation.modelIdentifier}{suffix}"
        token = description.guid if is_2 else description.instantiationToken
        resources = (folder / "resources").as_uri() if is_2 else f"{folder / 'resources'}/"
        table = np.column_stack([np.asarray(column, dtype=float) for column in rows.values()])
        experiment = [
            f"{STEP!r} {len(table)}",
            f"{len(starts or {})} "
            + " ".join(f"{reference[name]} {value!r}" for name, value in (starts or {}).items()),
            f"{len(rows)} " + " ".join(str(reference[name]) for name in rows),
            f"{len(outputs)} " + " ".join(str(reference[name]) for name in outputs),
            f"{len(texts or {})} " + " ".join(f"{reference[name]} {text}" for name, text in (texts or {}).items()),
            *(" ".join(map(repr, row)) for row in table.tolist()),
        ]
        return subprocess.run(
            [*self.command, str(library), description.fmiVersion[0], token, resources],
            input="\n".join(experiment) + "\n",
            capture_output=True,
            text=True,
            check=False,
            timeout=300,
            env={**os.environ, **self.environment},
        )


def host_here(folder: Path, **environment: str) -> Host:
    """The host for this machine, compiled into a folder."""
    compiler, program = c_compiler(), folder / "host"
    assert compiler is not None
    subprocess.run([compiler, "-w", f"-I{_HEADERS}", str(_SOURCE), "-o", str(program), "-ldl"], check=True)
    return Host(command=[str(program)], environment=environment)


def host_of_windows(folder: Path, prefix: Path, **environment: str) -> Host:
    """The host for Windows, compiled into a folder, in Wine's ``prefix``."""
    program, using = compiled_for_windows(_SOURCE, folder), wine()
    assert using is not None
    own = {"WINEDEBUG": "-all", "WINEPREFIX": str(prefix), **environment}
    return Host(command=[using, str(program)], platform="win64", environment=own)
