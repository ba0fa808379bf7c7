"""Write a table of hashes of computed results, or compare with one, to check that a refactoring changes nothing.

    python tests/baselines/fingerprints.py write before.json
    python tests/baselines/fingerprints.py compare before.json

Every shipped scenario runs with exact off-tracking or slip, some also with cameras. Vehicles are described and one is
assessed, recordings are estimated, a study and exports are made, keys and parts are listed, and one
environment of each kind runs for some steps. All use the command or gymnasium's registry, so tables of different
versions can be compared even if modules have moved. Hashes depend on the processor and OpenGL: compare only tables of
the same machine.

A difference is printed as ``case: signal, changed|gone|new``. The exit code is 1 if anything changed or is gone. New
signals and new numbers are listed but are no failure.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

Fingerprint = dict[str, str]  # hash by name of signal or number


_RUNS = {  # settings of runs besides those of the scenarios as they are
    "roundabout with cameras": ("roundabout", ["course.turn_deg=90"]),
    "roundabout, side, self-calibrated": (
        "roundabout-right",
        ["rig.facing=left", "rig.calibration=boards", "rig.self_calibration=true", "course.turn_deg=45"],
    ),
    "constant-slip, viso2": ("constant-slip", ["odometry=viso2", "course.length=30"]),
    "farm-track, ground watching": (
        "farm-track",
        ["off_tracking=ground_watching", "course.entry=20", 'course.turns=[{direction="left",radius=15,turn_deg=45}]'],
    ),
    "figure-of-eight, B-double, faults, traffic": (
        "roundabout",
        ["vehicle=b_double_steered", "faults=dropout:0.1;freeze@8+0.3", "traffic=following", "course.turn_deg=45"],
    ),
    "roundabout, surrogate": ("roundabout", ["off_tracking=surrogate"]),
    "roundabout, kinematic": ("roundabout", ["off_tracking=kinematic"]),
    "rover-slope with a camera": ("rover-slope", ["course.length=5"]),
    "rover-uphill, ftrace": ("rover-uphill", ["slip_estimator=ftrace", "course.length=2"]),
    "rover-craters with a camera": ("rover-craters", ["course.length=2"]),
}
_RECORDED = ("roundabout with cameras", "rover-slope with a camera")


def cases() -> dict[str, Callable[[Path], Fingerprint]]:
    """Cases by name; each writes into its own folder."""
    runs: dict[str, tuple[str, list[str]]] = {}
    for name in _scenario_names():
        exact = f"{'slip_estimator' if name.startswith('rover') else 'off_tracking'}=truth"
        runs[f"{name} with {exact}"] = name, [exact]
    return {
        **{title: partial(_run_case, title, *of) for title, of in (runs | _RUNS).items()},
        "assess eu_tractor_semitrailer": _assess_case,
        "environments": lambda _: json.loads(_output(sys.executable, "-c", _ROLLOUT)),
        "listings": _listings_case,
        "vehicle sheets": _sheets_case,
        "recordings": _recordings_case,
        "study": _study_case,
        "exports": _exports_case,
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=["write", "compare"])
    parser.add_argument("table", type=Path, help="JSON file of hashes")
    parser.add_argument("--only", default="", help="run only cases whose name contains this text")
    chosen = parser.parse_args()
    table = {name: case for name, case in cases().items() if chosen.only in name}
    with tempfile.TemporaryDirectory() as root, ThreadPoolExecutor(os.cpu_count()) as pool:
        futures = {name: pool.submit(case, Path(root) / str(k)) for k, (name, case) in enumerate(table.items())}
        current = {name: future.result() for name, future in futures.items()}
    if chosen.action == "write":
        chosen.table.write_text(json.dumps(current, indent=1) + "\n", encoding="utf-8")
        return 0
    before = {
        name: of for name, of in json.loads(chosen.table.read_text(encoding="utf-8")).items() if chosen.only in name
    }
    worse = 0
    for case, old in before.items():
        now = current.get(case, {})
        for name in sorted(name for name in old.keys() | now.keys() if old.get(name) != now.get(name)):
            kind = "gone" if name not in now else "changed" if name in old else "new"
            worse += kind != "new"
            print(f"{case}: {name}, {kind}")
    print(f"{len(current)} cases, {sum(map(len, current.values()))} hashes, {worse} changed or gone")
    return 1 if worse else 0


def _command(*arguments: str) -> str:
    """Output of an offtrack command."""
    return _output(sys.executable, "-m", "offtrack", *arguments)


def _output(*command: str) -> str:
    """Output of a program; one that fails ends this one with its error."""
    # One thread per process: the processes share the cores, and sums keep their order.
    single_thread = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "LP_NUM_THREADS": "1"}
    environment = os.environ | single_thread | {"COLUMNS": "400"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)} ended with {done.returncode}\n{done.stderr}")
    return done.stdout


def _scenario_names() -> list[str]:
    return [line.split()[0] for line in _command("scenarios").splitlines() if line.strip()]


def _run_case(title: str, name: str, settings: list[str], folder: Path) -> Fingerprint:
    out, recording = folder / "run", folder / "recording"
    words = [part for setting in settings for part in ("--set", setting)]
    words += ["--record", str(recording)] if title in _RECORDED else []
    _command("run", name, "--seed", "7", "--no-video", "--quiet", "--out", str(out), *words)
    hashes = _signals(out / "signals.parquet") | _numbers(out / "summary.json")
    hashes["images"] = json.loads((out / "manifest.json").read_text())["frames_sha256"]
    if title in _RECORDED:
        hashes["recording"] = _folder_hash(recording)
    return hashes


def _assess_case(folder: Path) -> Fingerprint:
    out = folder / "assessment"
    _command("assess", "eu_tractor_semitrailer", "--json", "--out", str(out))
    return _numbers(out / "assessment.json")


def _listings_case(folder: Path) -> Fingerprint:
    """Keys with units, ranges and defaults, and parts."""
    listed = {f"keys {name}": _command("keys", name, "--json") for name in _scenario_names()}
    return {name: _text_hash(text) for name, text in {**listed, "parts": _command("parts", "--json")}.items()}


def _sheets_case(folder: Path) -> Fingerprint:
    names = [file.stem for kind in ("parameters", "rovers") for file in sorted(Path("vehicle", kind).glob("*.toml"))]
    return {name: _text_hash(_command("vehicle", name, "--json")) for name in names}


def _recordings_case(folder: Path) -> Fingerprint:
    hashes: Fingerprint = {}
    for name, length, what in (("constant-slip", 25, "off-tracking"), ("rover-slope", 3, "slip")):
        images, out, options = folder / f"{name} images", folder / f"{name} estimated", ("--quiet", "--no-video")
        recorded = ("--set", f"course.length={length}", "--record", str(images), "--out", str(folder / name))
        _command("run", name, *options, *recorded)
        _command("estimate", what, str(images), *options, "--out", str(out))
        hashes |= _numbers(out / "summary.json", name)
    return hashes


def _study_case(folder: Path) -> Fingerprint:
    short = ["--set", "course.turn_deg=30", "--jobs", "1", "--quiet"]
    laws = ["--controllers", "command_steer,path_preview", "--seeds", "2"]
    _command("compare", "roundabout", *laws, *short, "--out", str(folder / "study"))
    return {file.name: _text_hash(file.read_text()) for file in sorted((folder / "study").glob("table*.csv"))}


def _exports_case(folder: Path) -> Fingerprint:
    run = folder / "run"
    _command("run", "turn-90", "--quiet", "--no-video", "--set", "off_tracking=truth", "--out", str(run))
    _command("export", str(run), "--to", "csv")
    _command("draw", str(run), "--to", "geojson")
    return {file.name: _text_hash(file.read_text()) for file in sorted([*run.glob("*.csv"), *run.glob("*.geojson")])}


def _text_hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


_ROLLOUT = """
import hashlib, json
import gymnasium, numpy as np
import offtrack
def rollout(name, steps, **options):
    env = gymnasium.make(name, **options)
    digest = hashlib.sha256()
    observation, info = env.reset(seed=3)
    rng = np.random.default_rng(1)
    for _ in range(steps):
        parts = observation.values() if isinstance(observation, dict) else [observation]
        for part in parts:
            digest.update(np.ascontiguousarray(part).tobytes())
        shape = env.action_space.shape
        observation, reward, ended, cut, info = env.step(rng.uniform(-0.3, 0.3, shape).astype(np.float32))
        digest.update(np.float64(reward).tobytes())
        if ended or cut:
            break
    env.close()
    return digest.hexdigest()
table = {}
for kind in ("surrogate", "truth", "estimate", "camera"):
    table[f"trailer {kind}"] = rollout("offtrack/TrailerSteering-v0", 300 if kind in ("surrogate", "truth") else 60,
                                       observation=kind)
for kind in ("truth", "estimate", "camera"):
    table[f"rover {kind}"] = rollout("offtrack/RoverSteering-v0", 60, observation=kind)
print(json.dumps(table))
"""


def _signals(path: Path) -> Fingerprint:
    import numpy as np
    import pyarrow.parquet as pq

    table, found = pq.read_table(path), {}
    for name in table.column_names:
        values = np.nan_to_num(table[name].to_numpy(zero_copy_only=False).astype(float), nan=1e300)
        found[name] = hashlib.sha256(values.tobytes()).hexdigest()[:16]
    return found


def _numbers(file: Path, prefix: str = "summary") -> Fingerprint:
    """Every number of a JSON file by its path, except computing times, which vary between runs."""

    def numbers(value: Any, path: str) -> Iterator[tuple[str, str]]:
        if isinstance(value, dict):
            for name, inner in value.items():
                if name != "timing":
                    yield from numbers(inner, f"{path}.{name}")
        else:
            yield path, json.dumps(value)

    return dict(numbers(json.loads(file.read_text(encoding="utf-8")), prefix))


def _folder_hash(folder: Path) -> str:
    digest = hashlib.sha256()
    for file in sorted(path for path in folder.rglob("*") if path.is_file()):
        digest.update(file.relative_to(folder).as_posix().encode() + file.read_bytes())
    return digest.hexdigest()[:16]


if __name__ == "__main__":
    sys.exit(main())
