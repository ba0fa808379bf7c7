"""A clean environment without the repository: wheel and source archive run there, on every Python of this machine.

The newest versions of what offtrack depends on, and the lowest that it names.
"""

import os
import re
import shutil
import subprocess
import sys
import tomllib
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LOWEST = "lowest"
LINK = re.compile(r"\]\((?!https?://)")

pytestmark = pytest.mark.slow


def interpreter(name: str) -> str:
    """An interpreter of this name, by the search path or of pyenv; the test is skipped if there is none."""
    versions = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    for one in (shutil.which(name), *map(str, sorted(versions.glob(f"*/bin/{name}")))):
        works = one and subprocess.run([one, "-c", "import venv, ensurepip"], capture_output=True, check=False)
        if works and works.returncode == 0:
            return str(one)
    pytest.skip(f"{name} is not on this machine")


def lowest() -> list[str]:
    """Direct dependencies at the lowest version that pyproject.toml names."""
    lines = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    return [re.sub(r">=([^,]+).*", r"==\1", line) for line in lines]


CASES = [(sys.executable, "wheel", LOWEST), (sys.executable, "sdist", "newest")]
CASES += [(f"python3.{minor}", "wheel", "newest") for minor in (11, 12, 13)]


@pytest.mark.parametrize(("python", "archive", "versions"), CASES)
def test_it_runs_without_the_repository(python: str, archive: str, versions: str, tmp_path: Path) -> None:
    builders = pytest.importorskip(f"hatchling.builders.{archive}", reason="pip install 'offtrack[dev]'")
    builder = {"wheel": "WheelBuilder", "sdist": "SdistBuilder"}[archive]
    (built,) = getattr(builders, builder)(str(ROOT)).build(directory=str(tmp_path), versions=["standard"])
    clean = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "PIP_CONSTRAINT")}

    def called(*command: str) -> str:
        done = subprocess.run(command, cwd=tmp_path, env=clean, capture_output=True, text=True, check=False)
        assert done.returncode == 0, (command, done.stdout, done.stderr)
        return done.stdout

    if python == sys.executable:
        venv.create(tmp_path / "env", with_pip=True)
    else:
        called(interpreter(python), "-m", "venv", str(tmp_path / "env"))
    inside = tmp_path / "env" / "bin"
    called(str(inside / "python"), "-m", "pip", "install", "-q", built, *(lowest() if versions == LOWEST else ()))
    (about,) = (tmp_path / "env").glob("lib/python3*/site-packages/offtrack-*.dist-info")
    assert {path.name for path in about.rglob("licenses/**/*LICENSE")} == {"LICENSE", "uPlot.LICENSE"}
    assert not LINK.search((about / "METADATA").read_text("utf-8"))  # a relative one leads nowhere from an index
    command = str(inside / "offtrack")
    assert called(command, "--version").startswith("offtrack ")
    short = ("--set", "course.turn_deg=30")
    called(command, "run", "roundabout", *short, "--no-video", "--quiet", "--out", "run")
    called(command, "assess", "eu_tractor_semitrailer", "--manoeuvres", "turn", "--quiet", "--out", "assessed")
    called(command, "compare", "roundabout", *short, "--controllers", "none", "--off-tracking", "truth", "--quiet")
    code = "import offtrack, gymnasium; print(offtrack.load_run('run')['off_tracking_true'].unit); "
    code += "print(gymnasium.make('offtrack/TrailerSteering-v0').reset(seed=1)[0].shape)"
    assert called(str(inside / "python"), "-c", code).split() == ["m", "(18,)"]
    assert (tmp_path / "run/report.html").is_file()
