"""What commands refuse: one line on standard error that names the mistake, exit code 2, and nothing written."""

from __future__ import annotations

import re
import shlex
import shutil
import socket
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from offtrack.commands.cli import app
from scenarios.results.log import Log, Signal, write_log

PARAMETERS = Path(__file__).parents[3] / "vehicle" / "parameters"
STUDY = 'scenario = "cambered-road"\n[vary]\nspeed_kmh = [50, 60]\n'
DARK = 'scenario = "roundabout"\n[set]\noff_tracking = "truth"\n[vary]\ntrailer_steering = ["none"]\n'
DARK += '[[fault]]\nkind = "blackout"\nonsets = [5]\n[requirements]\nsteer.max_deg = 45\n'
CALIBRATION = "".join(f"P{k}: 60 0 31.5 {-30 * k} 0 60 15.5 0 0 0 1 0\n" for k in (0, 1))
TRUCK = {  # changes of a shipped file
    "mass.toml": ("mass = { value = 18000.0", "mass = { value = -18.0"),
    "limit.toml": ("limit_deg = { value = 42.0", "limit_deg = { value = 420"),
    "slip.toml": ("peak_slip = { value = [0.12, 0.15]", "peak_slip = { value = [0.95, 0.15]"),
    "key.toml": ("\ntrack", "\ntrak"),
}
BUS = 'VERSION ""\n\nBU_: A B\n\nBO_ 256 Signals: 8 A\n SG_ speed : 0|8@1+ (0.5,0) [0|100] "{}" B\n'


def black(path: Path, size: tuple[int, int] = (32, 64)) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.zeros(size, np.uint8))


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with a run, a recording and photographs, damaged files, and a directory in use."""
    folder = tmp_path_factory.mktemp("place")
    texts = {
        "broken.toml": "name = ", "full/kept.txt": "kept", "study.toml": STUDY, "dark.toml": DARK, "empty/.keep": "",
        "wrong.toml": "scenari = 1\n[[fault]]\nkind = 'dropout'", "run/signals.csv": "", "photos/no.png": "no image",
        "number/scenario.toml": "trailer_steering = 3", "rover/scenario.toml": 'kind = "rover"\nname = "r"\n',
        "bad.dbc": "BO_ what", "lacks.dbc": BUS.format("km/h"), "furlong.dbc": BUS.format("furlong"),
        "demands.csv": "tick,steer\n0,1\n", "camera.toml": "", "another/journal.log": "",
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
    shutil.copytree(folder / "yard", folder / "cut")
    for image in (folder / "cut" / "image_0").iterdir():
        image.write_bytes(image.read_bytes()[:40])
    for name in ("left/0", "left/1", "right/0", "right/1"):
        black(folder / "photos" / f"{name}.png")
    black(folder / "photos" / "small.png", (10, 10))
    truck = (PARAMETERS / "rigid_truck.toml").read_text(encoding="utf-8")
    for name, (old, new) in TRUCK.items():
        assert old in truck
        (folder / name).write_text(truck.replace(old, new, 1), encoding="utf-8")
    rover = (PARAMETERS.parent / "rovers" / "el_dorado_ii.toml").read_text(encoding="utf-8")
    (folder / "rover.toml").write_text(rover.replace("value = 28.4", "value = -28.4", 1), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def ports() -> Iterator[dict[str, str]]:
    with socket.socket() as tcp, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        for taken in (tcp, udp):
            taken.bind(("127.0.0.1", 0))
        tcp.listen()
        yield {"TCP": str(tcp.getsockname()[1]), "UDP": str(udp.getsockname()[1])}


RUN = "run roundabout --set off_tracking=truth"
OUTSIDE = f"{RUN} --set outside.demands=trailer"
LAW = "fmu law path_preview --vehicle"
BOARD = "--board 7x5 --square 0.05 --out rig.toml"
PHOTO = "photos/left/0.png"
YARD = "estimate off-tracking yard"
TUNE = "tune roundabout --set off_tracking=truth"
ASSESS = "assess rigid_truck --manoeuvres"
ROVER = "is a rover's: its camera sees the sand that its own wheels have just shaped"
REFUSED = [  # command line, and words of the answer in their order
    ("run roundabut", "roundabut…roundabout"),
    ("run roundabout --set surface.fricton=0.3", "surface.fricton…surface.friction"),
    ("run roundabout --set surface.friction=9", "surface.friction = 9…1.5"),
    ("run roundabout --set surface.cross_fall=2.5", "surface.cross_fall = 2.5…0.2"),
    pytest.param("run roundabout --set rig.rate_hz=7", "rig.rate_hz", marks=pytest.mark.slow),
    ("run roundabout --set speed_kmh=fast", "speed_kmh…fast"),
    ("run roundabout --set vehicle=uk_longer_semitrailr", "uk_longer_semitrailr…uk_longer_semitrailer"),
    ("run roundabout --set vehicle=none.toml", "none.toml"),
    ("run roundabout --set trailer_steering=path_preveiw", "path_preveiw…path_preview"),
    ("run roundabout --set trailer_steering=no_such_module:Law", "no_such_module"),
    ("run roundabout --set steering.gian=1", "gian"),
    ("run roundabout --set steering.gain=-1", "gain = -1"),
    pytest.param("run roundabout --set odometry=orb", "orb…circular", marks=pytest.mark.slow),
    ("run roundabout --set off_tracking=guess", "guess…viso_ot"),
    ("run constant-slip --set trailer_steering=path_preview", "trailer_steering…none"),
    ("run broken.toml", "broken.toml"),
    ("run roundabout --out full", "full…not empty"),
    ("run roundabout --speed 2", "--speed 2: needs --paced"),
    ("run roundabout --paced --speed 0", "--speed = 0.0 must be between 0.01 and 100"),
    ("run turn-90 --watch --watch-port 70000", "--watch-port"),
    ("run turn-90 --watch --watch-port TCP", "--watch-port"),
    (f"{RUN} --udp 127.0.0.1:5005,UDP", "port UDP can't be opened: Address already in use"),
    (f"{OUTSIDE} --set outside.wait=1", "needs --udp, --can, or outside.record"),
    (f"{OUTSIDE} --udp 127.0.0.1:UDP", "needs --paced, or outside.wait"),
    (f"{RUN} --can dbc=bad.dbc", "bad.dbc is no DBC file"),
    (f"{RUN} --can dbc=none.dbc", "none.dbc"),
    (f"{RUN} --can interface=virtual", "dbc=FILE is missing"),
    (f"{RUN} --can dbc=example,interface=udp_multicast", "interface 'udp_multicast'"),
    (f"{RUN} --can dbc=example,interface=socketcan,channel=nocan7", "the bus can't be opened"),
    (f"{OUTSIDE} --set outside.wait=1 --can dbc=lacks.dbc", "no message has the signal steer_demand_1"),
    (f"{RUN} --can dbc=furlong.dbc", "speed has the unit 'furlong', which is no unit of m/s"),
    (f"{OUTSIDE} --set outside.record=demands.csv", "column 'came_semitrailer' is missing"),
    ("fmu plant nix", "unknown vehicle or rover 'nix'"),
    ("fmu plant rigid_truck --fmi 4", "--fmi 4: must be 2 or 3"),
    ("fmu plant rigid_truck -o truck.zip", "must end in .fmu"),
    ("fmu plant rigid_truck -o nowhere/truck.fmu", "there is no folder nowhere"),
    ("fmu plant rigid_truck --platform amiga", "must be one of linux64"),
    ("fmu plant rigid_truck --platform darwin-arm64 --fmi 2", "FMI 2 has no name for it"),
    ("fmu plant rigid_truck --soil beach_sand", "is no rover"),
    ("fmu plant el_dorado_ii --wind", "no inputs for the wind"),
    ("fmu law nix --vehicle uk_longer_semitrailer", "unknown name 'nix'"),
    (f"{LAW} rigid_truck", "no axle of a trailer is steered"),
    (f"{LAW} uk_longer_semitrailer --set speed_kmh=3", "a law has only the keys steering"),
    (f"{LAW} uk_longer_semitrailer --set steering.gian=3", "unknown key 'steering.gian'; did you mean 'gain'?"),
    *((f"fmu {kind} rover-craters", ROVER) for kind in ("sensor", "driver", "ground", "system")),
    ("vehicle mass.toml", "mass.toml…units.0.mass = -18.0 kg must be between 100 and"),
    ("vehicle limit.toml", "units.0.steering.limit_deg = 420 deg…at most 80 deg"),
    ("vehicle slip.toml", "sliding_slip = 0.9…peak_slip"),
    ("vehicle key.toml", "units.0.axles.0.trak…did you mean 'track'"),
    ("vehicle rover.toml", "rover.toml…mass = -28.4 kg"),
    ("vehicle b_dubble", "did you mean 'b_double'?"),
    ("vehicle el_dorado_2", "did you mean 'el_dorado_ii'?"),
    ("vehicle rigid_truck --out full", "full…not empty"),
    ("assess eu_tractor_semitrailr", "eu_tractor_semitrailer"),
    ("assess none.toml", "none.toml"),
    ("assess eu_tractor_semitrailer --trailer-steering path_preview", "no steered axle"),
    ("assess uk_longer_semitrailer --trailer-steering path_preveiw", "path_preview"),
    ("assess eu_tractor_semitrailer --out full", "not empty"),
    (f"{ASSESS} turn,lane_chnge", "'lane_chnge' is unknown; did you mean 'lane_change'"),
    (f"{ASSESS} turn --speed 90", "--speed 90: turn is driven at 1 to 20 km/h"),
    ("assess rigid_truck --speed 60", "--speed 60: turn is driven at 1 to 20 km/h; choose others with --manoeuvres"),
    (f"{ASSESS} pulse --radius 15", "--radius: none of the manoeuvres pulse has a radius"),
    (f"{ASSESS} turn --radius nan", "--radius nan: turn is driven at 8 to 100 m"),
    (f"{ASSESS} pulse --friction 7", "--friction 7: pulse is driven at 0.05 to 1.5"),
    ("assess rigid_truck --loads halff", "load = 'halff' is not a load case; did you mean 'half'"),
    ("validate --out full", "not empty"),
    ("reproduce reina2008-fig9", "reina2008-fig"),
    ("reproduce reina2008-fig6 --quick --out full", "not empty"),
    ("compare roundabout --controllers path_previw", "unknown name 'path_previw'; did you mean 'path_preview'?"),
    ("compare roundabout --off-tracking truht", "unknown name 'truht'"),
    ("compare roundabout --vary surface.friction", "--vary surface.friction: expected KEY=VALUE"),
    ("compare roundabout --vary surface.friction=0.8,0.8", "expected different values"),
    ("compare roundabout --vary surface.frction=0.8,0.3", "unknown key 'surface.frction'"),
    ("compare roundabout --seeds 5-1", "--seeds 5-1: expected whole numbers"),
    ("compare roundabout --seeds ²", "--seeds ²: expected whole numbers"),
    ("compare roundabout --seeds 1-100000000", "100000000 seeds; a study has at most 20000 runs"),
    ("compare roundabout --seeds 1-15000 --vary speed_kmh=10,20", "90000 runs: a study has at most 20000"),
    ("compare roundabout --jobs 100000", "--jobs = 100000 must be between 1 and 1024"),
    ("sweep study.toml --scheduler tcp://h:1 --dask-jobqueue q.yaml", "choose one"),
    ("sweep study.toml --scheduler tcp://h:1 --jobs 2", "leave it out"),
    ("sweep study.toml --dask-jobqueue q.yaml", "needs --jobs"),
    ("sweep study.toml --scheduler tcp://h:1 --patience 0", "--patience"),
    ("campaign trailer-steering-fault", "did you mean 'trailer-steering-faults'"),
    ("campaign roundabuot", "did you mean 'roundabout'"),
    ("campaign wrong.toml", "did you mean 'scenario'"),
    ("campaign dark.toml", "fault blackout: blackout needs a camera"),
    (f"{TUNE} --range gian=0:1", "path_preview has no such parameter; did you mean 'gain'?"),
    (f"{TUNE} --trials 1000000", "--trials = 1000000 must be between 1 and 100000"),
    (f"{TUNE} --jobs 0", "--jobs = 0 must be between 1 and 1024"),
    (f"{TUNE} --range gain=1:0", "--range gain=1:0: expected LOW:HIGH"),
    (f"{TUNE} --objectives off_tracking.true_rms", "no such summary metric"),
    (f"{TUNE} --out another", "belongs to another tuning task"),
    (f"{TUNE} --storage mysql://me:s3cret@host/x", "expected postgresql://"),
    (f"{TUNE} --storage postgresql://me:s3cret@127.0.0.1:1/x?connect_timeout=2", "the database can not be used"),
    (f"{TUNE} --storage nonsense", "expected postgresql://"),
    (f"{TUNE} --storage sqlite:////no/such/folder/x.db", "the database can not be used"),
    (f"{TUNE} --storage postgresql:x", "is no address"),
    (f"calibrate nowhere {BOARD}", "no such file or folder"),
    (f"calibrate empty {BOARD}", "contains no images"),
    (f"calibrate photos/no.png {BOARD}", "is corrupt or not an image"),
    (f"calibrate {PHOTO} {BOARD}", "no image of 1 shows a board of 7x5 inner corners"),
    (f"calibrate {PHOTO} photos/small.png {BOARD}", "all images must come from one camera at one resolution"),
    (f"calibrate {PHOTO} --square 0.05 --out rig.toml --board 9by6", "expected COLUMNSxROWS"),
    (f"calibrate {PHOTO} --square 0.05 --out rig.toml --board 2x2", "at least 3x3 inner corners"),
    (f"calibrate {PHOTO} {BOARD} --position 3", "expected X,Y,Z in metres"),
    ("calibrate photos --board 7x5 --square 0.05 --out camera.toml", "exists already"),
    ("estimate off-tracking nowhere", "nowhere…not a folder"),
    ("estimate off-tracking no-image_1", "image_1…missing"),
    ("estimate off-tracking empty", "image_0 and image_1"),
    ("estimate off-tracking no-calib.txt", "calib.txt is missing…--calibration"),
    ("estimate off-tracking no-times.txt", "times.txt is missing…--rate"),
    ("estimate off-tracking cut", "image_0/000000.png is corrupt or not an image"),
    (f"{YARD} --calibration none.toml", "none.toml: cannot be read"),
    (f"{YARD} --calibration none.txt", "none.txt is missing"),
    (f"{YARD} --rate 0", "--rate"),
    (f"{YARD} --follow-distance -3", "--follow-distance = -3"),
    (f"{YARD} --facing up", "--facing = up…rear"),
    (f"{YARD} --camera-height 0", "--camera-height = 0"),
    (f"{YARD} --odometry circlar", "circlar…circular"),
    (f"{YARD} --facing rear --out yard", "yard…not empty"),
    (f"{YARD} --topics left=/a", "is no bag"),
    ("export run --to csv", "exists already"),
    ("export none", "is no directory of a finished run"),
    ("export run --to mat --out none/x.mat", "there is no folder"),
    ("export run --to msf4", "--to: unknown name 'msf4'; did you mean 'mf4'?"),
    ("export run --images run --out new.csv", "csv takes no images: choose --to mcap or rosbag2"),
    ("draw empty", "is no run directory: it has no scenario.toml"),
    ("draw number", "scenario.toml"),
    ("draw rover", "scenario.toml"),
    ("view empty", "is no finished run: it has no summary.json"),
]  # fmt: skip


@pytest.mark.parametrize(("line", "says"), REFUSED)
def test_wrong_input_is_refused_in_one_line(
    line: str, says: str, place: Path, ports: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(place)
    monkeypatch.setattr(sys, "path", list(sys.path))  # the catalogue adds the working directory
    for name, port in ports.items():
        line, says = (re.sub(rf"\b{name}\b", port, text) for text in (line, says))
    before = sorted(place.rglob("*"))
    done = CliRunner().invoke(app, shlex.split(line))
    assert (done.exit_code, done.stdout) == (2, ""), done.output
    (told,) = done.stderr.splitlines()
    assert told.startswith("offtrack: ")
    assert re.search(".*".join(map(re.escape, says.split("…"))), told), told
    assert "s3cret" not in told
    assert sorted(place.rglob("*")) == before
