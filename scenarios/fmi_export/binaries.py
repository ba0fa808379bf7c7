"""Libraries of an FMU for one or several platforms, compiled from its own sources."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

from vehicle.engine.compiler import compiler, engine_name


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


def checked_platforms(names: Sequence[str], version: int) -> tuple[str, ...]:
    """The platforms, each once, linux64 first.

    Raises:
        ValueError: one line, if one is unknown, has no name in this version of FMI, or cannot be compiled here.
    """
    for name in names:
        if name not in PLATFORMS:
            raise ValueError(f"--platform {name}: must be one of {', '.join(PLATFORMS)}")
        if version == 2 and PLATFORMS[name].folder_2 is None:
            raise ValueError(f"--platform {name}: FMI 2 has no name for it; choose --fmi 3")
        if name != "linux64" and not _has_zig():
            raise ValueError(f"--platform {name}: needs Zig's compiler; install it with: pip install 'offtrack[zig]'")
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
    with tempfile.TemporaryDirectory(prefix="offtrack-fmu-") as folder:
        built = Path(folder, f"library{of.suffix}")
        environment = dict(os.environ, ZIG_LOCAL_CACHE_DIR=folder)
        if _has_zig():
            command = [sys.executable, "-m", "ziglang", "cc", "-target", of.target, "-fno-sanitize=undefined", "-s"]
        else:
            assert using is not None
            command = [using.path]
        math = [] if platform == "win64" else ["-lm"]
        arguments = [*command, *_FLAGS, f"-O{optimisation}", *files, "-o", str(built), *math]
        done = subprocess.run(arguments, cwd=sources, env=environment, capture_output=True, text=True, check=False)
        if done.returncode != 0 or not built.exists():
            raise ValueError(f"--platform {platform}: the compiler failed: {' '.join(done.stderr.split())[:_LONGEST]}")
        return built.read_bytes()


def _has_zig() -> bool:
    return importlib.util.find_spec("ziglang") is not None
