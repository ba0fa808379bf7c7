"""What commands refuse: one line on standard error that names the mistake, exit code 2, and nothing written."""

import re
import shlex
import shutil
import socket
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from offtrack.commands.cli import app
from scenarios.results.log import Log, Signal, write_log
from tests.scenarios.roads.test_opendrive import ROAD

VEHICLE = Path(__file__).parents[3] / "vehicle"
STUDY = 'scenario = "cambered-road"\n[vary]\nspeed_kmh = [50, 60]\n'
DARK = 'scenario = "roundabout"\n[set]\noff_tracking = "truth"\n[vary]\ntrailer_steering = ["none"]\n'
DARK += '[[fault]]\nkind = "blackout"\nonsets = [5]\n[requirements]\nsteer.max_deg = 45\n'
CALIBRATION = "".join(f"P{k}: 60 0 31.5 {-30 * k} 0 60 15.5 0 0 0 1 0\n" for k in (0, 1))


BUS = 'VERSION ""\n\nBU_: A B\n\nBO_ 256 Signals: 8 A\n SG_ speed : 0|8@1+ (0.5,0) [0|100] "{}" B\n'


def black(path: Path, size: tuple[int, int] = (32, 64)) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.zeros(size, np.uint8))


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with a run, a recording and photographs, damaged files, and a directory in use."""
    folder = tmp_path_factory.mktemp("place")
    texts = {
        "broken.toml": "name = ", "full/kept.txt": "kept", "study.toml": STUDY, "dark.toml": DARK,
        "gain.toml": "gain = 0.3\n",
        "both.toml": STUDY + "[set]\nspeed_kmh = 40\n", "empty/.keep": "",
        "wrong.toml": "scenari = 1\n[[fault]]\nkind = 'dropout'", "run/signals.csv": "", "photos/no.png": "no image",
        "number/scenario.toml": "trailer_steering = 3", "rover/scenario.toml": 'kind = "rover"\nname = "r"\n',
        "bad.dbc": "BO_ what", "lacks.dbc": BUS.format("km/h"), "furlong.dbc": BUS.format("furlong"),
        "demands.csv": "tick,steer\n0,1\n", "units.csv": "x,y\nm,m\n1,2\n", "empty.crg": "",
        "bend.xodr": ROAD, "cut.xodr": ROAD[:300],
        "bomb.gpx": '<!DOCTYPE gpx [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;&a;">]><gpx>&b;</gpx>',
        "camera.toml": "", "another/journal.log": "",
        "another/tuning.toml": 'law = "another"\n', "yard/calib.txt": CALIBRATION, "yard/times.txt": "0.0\n0.1\n",
    }  # fmt: skip
    for name, text in texts.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    write_log(Log((Signal("time", "s", "time"),), np.zeros((2, 1))), folder / "run" / "signals.parquet")
    for side in (0, 1):
        for k in range(2):
            black(folder / f"yard/image_{side}/{k:06d}.png")
    for missing in ("image_1", "calib.txt", "times.txt"):
        shutil.copytree(folder / "yard", folder / f"no-{missing}", ignore=shutil.ignore_patterns(missing))
    for name in ("cut", "wrong-poses", "wrong-calib", "wrong-rig"):
        shutil.copytree(folder / "yard", folder / name)
    for image in (folder / "cut" / "image_0").iterdir():
        image.write_bytes(image.read_bytes()[:40])
    for name in ("left/0", "left/1", "right/0", "right/1"):
        black(folder / "photos" / f"{name}.png")
    black(folder / "photos" / "small.png", (10, 10))
    return folder


@pytest.fixture(scope="module")
def ports() -> Iterator[dict[str, str]]:
    with socket.socket() as tcp, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        for taken in (tcp, udp):
            taken.bind(("127.0.0.1", 0))
        tcp.listen()
        yield {"TCP": str(tcp.getsockname()[1]), "UDP": str(udp.getsockname()[1])}


def table(name: str) -> Any:
    """Data of the tests from the file of this name beside this one."""
    return tomllib.loads(Path(__file__).with_name(name).read_text(encoding="utf-8"))


REFUSED, WRONG = table("refusals.toml"), table("wrong_files.toml")


def check_refused(line: str, says: str, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(place)
    monkeypatch.setattr(sys, "path", list(sys.path))  # the catalogue adds the working directory
    before = sorted(place.rglob("*"))
    done = CliRunner().invoke(app, shlex.split(line))
    assert (done.exit_code, done.stdout) == (2, ""), done.output
    (told,) = done.stderr.splitlines()
    assert told.startswith("offtrack: ")
    assert told.isprintable()  # neither line breaks nor escape codes
    assert len(told) < 1100
    assert re.search(".*".join(map(re.escape, says.split("…"))), told), told
    assert "s3cret" not in told
    assert sorted(place.rglob("*")) == before


@pytest.mark.parametrize(
    ("line", "says"),
    [*REFUSED["quick"].items(), *(pytest.param(*one, marks=pytest.mark.slow) for one in REFUSED["slow"].items())],
)
def test_wrong_input_is_refused_in_one_line(
    line: str, says: str, place: Path, ports: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, port in ports.items():
        line, says = (re.sub(rf"\b{name}\b", port, text) for text in (line, says))
    check_refused(line, says, place, monkeypatch)


@pytest.mark.parametrize(("kind", "old", "new", "says"), [(kind, *one) for kind in WRONG for one in WRONG[kind]["not"]])
def test_a_wrong_file_is_refused_in_one_line(
    kind: str, old: str, new: str, says: str, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = WRONG[kind]
    text = given["text"] if "text" in given else (VEHICLE / given["like"]).read_text(encoding="utf-8")
    assert old == "*" or old in text
    wrong = new if old == "*" else text.replace(old, new, 1) if old else text + new
    (place / "wrong").mkdir(exist_ok=True)
    (place / given["file"]).write_text(wrong, encoding="utf-8")
    check_refused(given["command"], says, place, monkeypatch)
