"""Kill commands at random moments: ``python -m tests.kills --moments 40 [--seed N] [--only run,compare]``."""

import argparse
import importlib.util
import random
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from tests.kills.campaign import COMMANDS, PATIENCE, RECORDING, SIGNALS, STUDY, killed, start


def main() -> int:
    """Try all moments, print what was found, and return 1 if anything is wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--moments", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default=",".join(COMMANDS), help="commands, separated by commas")
    options = parser.parse_args()
    commands = options.only.split(",")
    if "train" in commands and importlib.util.find_spec("stable_baselines3") is None:
        commands.remove("train")
        print("train is left out: the extra rl is not installed")
    rng, wrong = random.Random(options.seed), 0
    with tempfile.TemporaryDirectory(prefix="offtrack-kills-") as name:
        root, durations = Path(name), dict[str, float]()
        _finish(RECORDING, root)
        for k in range(options.moments):
            command, number = commands[k % len(commands)], SIGNALS[k // len(commands) % len(SIGNALS)]
            if command not in durations:
                durations[command] = _finish(COMMANDS[command], _folder(root, f"whole-{command}"))
            share, seconds = rng.random(), durations[command]
            code, kept, problems = killed(command, number, _folder(root, f"{k}"), _after(share * seconds))
            wrong += bool(problems)
            verdict = "; ".join(problems) or "ok"
            found = f"{command:13} {number.name:8} exit {code:4}  kept {kept:3}  {verdict}"
            print(f"{k + 1:3} at {100 * share:3.0f} % of {seconds:4.1f} s  {found}", flush=True)
    print(f"{options.moments} moments with seed {options.seed}: {wrong} with problems")
    return 1 if wrong else 0


def _after(seconds: float) -> Callable[[], bool]:
    until = time.monotonic() + seconds
    return lambda: time.monotonic() >= until


def _folder(root: Path, name: str) -> Path:
    folder = root / name.replace(" ", "")
    folder.mkdir()
    (folder / "study.toml").write_text(STUDY, encoding="utf-8")
    (folder / "images").symlink_to(root / "images")
    return folder


def _finish(command: list[str], folder: Path) -> float:
    """Run a command to its end; returns the time [s]."""
    begin, process = time.monotonic(), start(command, folder)
    said = process.communicate(timeout=PATIENCE)[1]
    if process.returncode != 0:
        raise SystemExit(f"{' '.join(command)} ends with {process.returncode}: {said}")
    return time.monotonic() - begin


if __name__ == "__main__":
    sys.exit(main())
