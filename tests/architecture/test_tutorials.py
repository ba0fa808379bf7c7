"""Tutorials, the first run, the README and programs of other pages: they run as they stand, from an empty folder."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

ROOT: Final = Path(__file__).resolve().parents[2]
DOCS: Final = ROOT / "docs"
FENCE: Final = re.compile(r"^ *```(\w+)\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)
NAMED: Final = re.compile(r"# ([\w.-]+\.(?:py|toml|yaml))\n")
NOT_HERE: Final = re.compile(
    r"make |pip |\. \.venv"
)  # what installs; and the demo, which is the first command of the README
NEEDS: Final = {"policy": "stable_baselines3", "fmu": "fmpy", "cluster": "distributed", "own-law": "optuna"}
TUTORIALS: Final = sorted(DOCS.glob("tutorials/*.md"))

pytestmark = pytest.mark.slow


def script_of(page: Path) -> Iterator[str]:
    """What a reader does with the blocks of a page: type commands, save files by their names, run other programs."""
    for language, block in FENCE.findall(page.read_text("utf-8")):
        text = re.sub("^   ", "", block, flags=re.MULTILINE) if block.startswith("   ") else block
        name = NAMED.match(text)
        if name:
            yield f"cat > {name[1]} <<'END'\n{text}END\n"
        elif language == "python":
            yield f"python - <<'END'\n{text}END\n"
        elif language == "sh":
            yield "".join(line for line in text.splitlines(keepends=True) if not NOT_HERE.match(line))


def run(script: str, folder: Path) -> str:
    """Output of a script, in which no command may fail."""
    search = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    environment = {**os.environ, "PATH": search, "PYTHONPATH": str(ROOT)}
    command = ["bash", "-euo", "pipefail", "-c", script]
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=1800
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize(
    "page", [ROOT / "README.md", DOCS / "first-run.md", *TUTORIALS], ids=lambda page: page.stem.lower()
)
def test_a_page_runs_by_copy_and_paste(page: Path, tmp_path: Path) -> None:
    """Each command succeeds, and programs print what the page says that they print."""
    pytest.importorskip(NEEDS.get(page.stem, "offtrack"))
    output = run("\n".join(script_of(page)), tmp_path)
    for printed in re.findall(r"prints\s+`([^`]+)`", page.read_text("utf-8")):
        assert printed in output


def programs(page: str) -> list[str]:
    """Programs of a page that are no modules of the reader's own, in order."""
    return [block for language, block in FENCE.findall((DOCS / page).read_text("utf-8")) if language == "python"]


@pytest.mark.parametrize("place", range(2))
def test_a_program_of_the_environments_prints_what_its_comment_says(place: int, tmp_path: Path) -> None:
    """The number in the comment of the last line, within a fifth: changes of the physics move its last digits."""
    program = programs("environments.md")[place]
    output = run(f"python - <<'END'\n{program}END\n", tmp_path)
    said, *_ = (float(number) for number in re.findall(r"-?\d+\.\d+", program.rpartition("#")[2]))
    printed = [float(number) for number in re.findall(r"-?\d+\.\d+", output)]
    assert any(abs(number - said) <= 0.2 * abs(said) for number in printed), (said, output)


def test_the_program_of_the_results_runs(tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    (program,) = programs("results.md")
    run(f"python - <<'END'\n{program}END\n", tmp_path)
    assert (tmp_path / "runs" / "slippery" / "summary.json").exists()


def test_the_system_of_fmus_runs_in_fmpy(tmp_path: Path) -> None:
    pytest.importorskip("fmpy")
    (program,) = programs("fmi.md")
    short = program.replace("stop_time=30.0", "stop_time=2.0")
    command = "offtrack fmu system roundabout --set off_tracking=truth -o loop.ssp"
    assert command in (DOCS / "fmi.md").read_text("utf-8")
    run(f"{command}\nexport OFFTRACK_PYTHON=$(command -v python)\npython - <<'END'\n{short}END\n", tmp_path)


def test_the_controller_by_udp_steers_the_run_that_waits_for_it(tmp_path: Path) -> None:
    """The program of the page is in the background; the command beside it is made shorter."""
    (program,) = programs("real-time.md")
    (command,) = re.findall(r"^offtrack run .*outside\.wait.*$", (DOCS / "real-time.md").read_text("utf-8"), re.M)
    (tmp_path / "bench.py").write_text(program, "utf-8")
    output = run(
        f"python bench.py & bench=$!\nsleep 1\n{command} --set course.turn_deg=30 --no-video --json\nkill $bench\n",
        tmp_path,
    )
    assert '"reproducible": false' in output
