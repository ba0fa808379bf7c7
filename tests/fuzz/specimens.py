"""Valid files of every kind that the program reads, made once; hostile ones are versions of these."""

import json
import math
import re
import shutil
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Final, cast

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pyopencrg
from rosbags.convert.converter import convert
from rosbags.typesys import Stores, get_typestore

import controllers.trailer_steering
import offtrack.exchange.bench
import scenarios
import vehicle
from offtrack.environments.registry import single
from offtrack.exchange.recordings.writers import RecordingWriter, RoverRecordingWriter
from scenarios.processes import each_in_a_worker
from sensors.camera.calibration_target import Checkerboard, board_image, random_board_pose
from sensors.camera.rig import CameraModel, RawStereoRig, StereoRig
from sensors.messages import RoverView, StereoFrame
from sensors.sand.trace_rig import nominal_rig
from tests.fmus.models import proportional_law
from tests.fuzz.case import Case
from tests.fuzz.child import result_of
from tests.open_drive import crossing
from vehicle.frames import transform
from vehicle.rover.description import load_rover
from vehicle.rover.truth import RoverTruth

FRAMES: Final = 6
RIG: Final = StereoRig(facing="rear", width=160, height=96, hfov=1.7, x=-10.0, y=0.0, z=3.0, baseline=0.5)
BOARD: Final = Checkerboard(columns=7, rows=5, square=0.05)
SHORT: Final = "course.kind=straight", "course.length=20", "off_tracking=truth", "speed_kmh=20"
SHORT_ROVER: Final = "course.length=0.5", "slip_estimator=truth"


def make(folder: Path, names: Iterable[str]) -> None:
    for name in names:
        (folder / name).mkdir(parents=True)
        SPECIMENS[name](folder / name)


def _parameters(folder: Path) -> None:
    package = Path(vehicle.__file__).parent
    shutil.copy(package / "parameters" / "uk_longer_semitrailer.toml", folder / "vehicle.toml")
    shutil.copy(Path(__file__).parents[1] / "vehicle/ground/tyre_files/truck_61.tir", folder / "tyre.tir")
    text = (package / "parameters" / "eu_tractor_semitrailer.toml").read_text(encoding="utf-8")
    tyred = re.sub(r'tyre = "\w+"', 'tyre = {law = "magic_formula", file = "tyre.tir"}', text)
    (folder / "tyred.toml").write_text(tyred, encoding="utf-8")
    shutil.copy(package / "rovers" / "el_dorado_ii.toml", folder / "rover.toml")
    shutil.copy(package / "soils" / "toyoura_sand.toml", folder / "soil.toml")
    data = Path(scenarios.__file__).parent / "data"
    shutil.copy(data / "farm-track.toml", folder / "trailer_scenario.toml")
    shutil.copy(data / "rover-craters.toml", folder / "rover_scenario.toml")
    fixed = "\n".join(f'"{key}" = "{value}"' for key, value in (pair.split("=") for pair in SHORT))
    (folder / "study.toml").write_text(
        f'scenario = "lane-change"\nseeds = [1, 2]\n[set]\n{fixed}\n[vary]\nspeed_kmh = [5, 10.5]\n'
        'trailer_steering = ["none", "command_steer"]\n',
        encoding="utf-8",
    )
    (folder / "campaign.toml").write_text(
        f'scenario = "lane-change"\nseeds = [1, 2]\n[set]\n{fixed}\n[vary]\ntrailer_steering = ["none"]\n'
        '[[fault]]\nkind = "gyro_bias"\namounts = [2, 5.5]\nonsets = [0.5]\ndurations = [1, "end"]\n'
        '[[fault]]\nkind = "actuator_stuck"\nonsets.uniform = [0.5, 1.5]\nonly.trailer_steering = "none"\n'
        "[requirements]\noff_tracking.true_max_m = 0.5\ntime_to_detect_s = 1\n[sample]\ncount = 2\n"
        '[[bisect]]\nfault = "gyro_bias"\nlow = 0\nhigh = 20\ntolerance = 5\n[accept]\nprobability = 0.5\n',
        encoding="utf-8",
    )
    (folder / "own.py").write_text(
        "from controllers.trailer_steering.signal_laws import CommandSteer\n\n\nclass Law(CommandSteer):\n"
        '    """A law of one\'s own."""\n',
        encoding="utf-8",
    )


def _ground(folder: Path) -> None:
    """Maps of heights and of friction, a recorded drive, roads, an FMU and a trained network."""
    y, x = np.mgrid[0:12, 0:16]
    heights = 0.02 * np.sin(x) * np.cos(y)
    np.save(folder / "heights.npy", heights)
    np.savetxt(folder / "heights.csv", heights, delimiter=",", fmt="%.4f")
    cv2.imwrite(str(folder / "friction.png"), (128 + 100 * np.sin(x)).astype(np.uint8))
    rows = [f"{0.5 * k},{3 * math.sin(k):.3f},{10 + k % 3},0.1" for k in range(20)]
    (folder / "drive.csv").write_text(
        "\n".join(["time_s,steer_deg,speed_kmh,acceleration", *rows, ""]), encoding="utf-8"
    )
    path = [(x, 0.001 * x * x) for x in range(30)]
    (folder / "path.csv").write_text(
        "\n".join(["x,y,z,bank,left_width,right_width,friction", *(f"{x},{y},0.1,0.01,4,5,0.7" for x, y in path)]),
        encoding="utf-8",
    )
    earth = [(0.1 + 1.5e-5 * x, 52.2 + 9e-6 * y) for x, y in path]
    points = "".join(f'<trkpt lon="{lon:.9f}" lat="{lat:.9f}"><ele>30</ele></trkpt>' for lon, lat in earth)
    (folder / "path.gpx").write_text(f"<gpx><trk><trkseg>{points}</trkseg></trk></gpx>", encoding="utf-8")
    (folder / "path.geojson").write_text(
        json.dumps({"type": "LineString", "coordinates": [[lon, lat, 30.0] for lon, lat in earth]}), encoding="utf-8"
    )
    (folder / "road.xodr").write_text(crossing(), encoding="utf-8")
    u = np.arange(0.0, 20.01, 0.1)
    surface = pyopencrg.CrgRoad(0.01 * np.sin(u)[:, None] * np.ones(21), u_inc=0.1, v=2.0, banking=0.01)
    surface.save(folder / "surface.crg", fmt="KRBI")
    surface.save(folder / "text.crg", fmt="LDFI")
    shutil.copy(Path(offtrack.exchange.bench.__path__[0]) / "example.dbc", folder / "bus.dbc")
    demands = [f"{20 * k},1,{0.01 * math.sin(k):.4f},0.01" for k in range(1, 20)]
    (folder / "demands.csv").write_text(
        "\n".join(["tick,came_semitrailer,steer_demand_1,steer_demand_2", *demands, ""]), encoding="utf-8"
    )
    proportional_law(folder)
    network = Path(controllers.trailer_steering.__path__[0]) / "networks" / "trailer_steering_v0.npz"
    shutil.copy(network, folder / "network.npz")


def _textured(k: int, side: int) -> np.ndarray:
    noise = np.random.default_rng([k, side]).integers(0, 256, (RIG.height // 8, RIG.width // 8), dtype=np.uint8)
    return cv2.resize(noise, (RIG.width, RIG.height), interpolation=cv2.INTER_CUBIC)


def _stereo(folder: Path) -> None:
    calibration = RIG.calibration()
    f = calibration.focal_length
    camera = CameraModel(width=RIG.width, height=RIG.height, fx=f, fy=f, cx=calibration.cx, cy=calibration.cy)
    right = transform(np.eye(3), np.array([RIG.baseline, 0.0, 0.0]))
    raw = RawStereoRig(left=camera, right=camera, X_ClCr=right, X_SC=calibration.X_SC)
    for name, rig in (("rectified", calibration), ("raw", raw)):
        with RecordingWriter(folder / name, rig, 10.0) as recording:
            for k in range(FRAMES):
                pose = transform(np.eye(3), np.array([0.5 * k, 0.0, 0.0]))
                recording.add(StereoFrame(tick=100 * k, left=_textured(k // 3, 0), right=_textured(k // 3, 1)), pose)


def _rover(folder: Path) -> None:
    rig = nominal_rig(load_rover("el_dorado_ii"))
    shape = (rig.camera.height, rig.camera.width)
    truth = cast(RoverTruth, SimpleNamespace(slip_angle=0.1))
    with RoverRecordingWriter(folder / "sand", rig) as recording:
        for k in range(FRAMES):
            image = np.random.default_rng(k).normal(150.0, 20.0, shape).clip(0, 255).astype(np.uint8)
            wheels = np.zeros(len(rig.wheels))
            view = RoverView(tick=200 * k, image=image, heading=0.01 * k, wheel_speeds=wheels + 0.8, steer=wheels)
            recording.add(view, truth)


def _photographs(folder: Path) -> None:
    camera = CameraModel(width=320, height=200, fx=210.0, fy=210.0, cx=158.0, cy=101.0)
    rng = np.random.default_rng(5)
    (folder / "photos").mkdir()
    for k in range(12):
        depth = rng.uniform(0.6, 0.9)
        ray = np.array([(-0.36, 0.0, 0.36)[k % 3], (-0.18, 0.0, 0.18)[k // 3 % 3]])
        X_CB = random_board_pose(BOARD, rng, ray=ray, depth=depth, tilt=rng.uniform(0.2, 0.6))
        image = board_image(BOARD, camera, X_CB, noise_std=2.0, rng=rng)
        cv2.imwrite(str(folder / "photos" / f"{k:02d}.png"), image)


def _results(folder: Path) -> None:
    run = folder / "run"
    run.mkdir()
    (run / "scenario.toml").write_text('off_tracking = "viso_ot"\n', encoding="utf-8")
    time = 0.1 * np.arange(120)
    error = np.random.default_rng(1).normal(0.0, 0.01, len(time)).cumsum()
    columns = {
        "time": time,
        "off_tracking_estimate": np.sin(time) + error,
        "off_tracking_true": np.sin(time),
        "health": (np.arange(len(time)) % 40 > 37) * 2.0,
    }
    pq.write_table(pa.table(columns), run / "signals.parquet")


def _finished(folder: Path, *commands: tuple[str, ...]) -> None:
    for command in commands:
        case = Case(kind="specimen", command=command, steps=1_000_000)
        ((_, done),) = each_in_a_worker(result_of, {"": (case, folder)}, jobs=1)
        if isinstance(done, BaseException) or done.code != 0:
            raise RuntimeError(f"{case.title()}: {done}")


def _study(folder: Path) -> None:
    from tests.fuzz.files import STUDY, TUNING  # which names the specimens

    _finished(folder, STUDY, TUNING)


def _run(folder: Path) -> None:
    """A finished run with its page, and another to compare it with."""
    from tests.fuzz.files import trailer  # which names the specimens

    _finished(folder, trailer())
    shutil.copytree(folder / "out", folder / "other")
    (folder / "out").rename(folder / "run")


def _bags(folder: Path) -> None:
    """The same stereo images as ROS 2 and ROS 1 bags, plain and packed in every way."""
    from tests.offtrack.recordings.test_rosbag2 import STORE, bag, stereo

    plain = bag(folder / "plain", stereo())
    (folder / "ros1").mkdir()
    for name, storage, packing, mode in (
        ("messages", "sqlite3", "zstd", "message"),
        ("file", "sqlite3", "zstd", "file"),
        ("mcap", "mcap", "zstd", "storage"),
        ("ros1/ros1.bag", "", "bz2", ""),
    ):
        types = get_typestore(Stores.ROS1_NOETIC) if packing == "bz2" else STORE
        convert([plain], folder / name, storage, 8, packing, mode, STORE, types, (), (), (), ())


def _foreign(folder: Path) -> None:
    """Calibrations of other programs, and a video of both cameras."""
    from tests.offtrack.recordings.test_calibration_files import SIZE, opencv

    (folder / "raw").mkdir()
    for ending in ("yaml", "xml"):
        opencv(folder / "raw", ending)
    video = cv2.VideoWriter(str(folder / "both.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (2 * SIZE[0], SIZE[1]))
    for k in range(FRAMES):
        pair = [cv2.resize(_textured(k // 3, side), SIZE) for side in (0, 1)]
        video.write(cv2.cvtColor(np.hstack(pair), cv2.COLOR_GRAY2BGR))
        for side, image in enumerate(pair):
            (folder / "raw" / f"image_{side}").mkdir(exist_ok=True)
            cv2.imwrite(str(folder / "raw" / f"image_{side}" / f"{k:06d}.png"), image)
    video.release()
    (folder / "raw" / "times.txt").write_text("".join(f"{0.1 * k}\n" for k in range(FRAMES)), encoding="utf-8")


def _training(folder: Path) -> None:
    """A model of stable-baselines3; its layers are not those of a training of offtrack, which can not resume it."""
    from stable_baselines3 import PPO

    (folder / "training").mkdir()
    model = PPO("MlpPolicy", single("TrailerSteering-v0"), policy_kwargs={"net_arch": [8]}, device="cpu")
    model.save(folder / "training" / "checkpoint.zip")


SPECIMENS: Final[Mapping[str, Callable[[Path], None]]] = {
    "parameters": _parameters,
    "ground": _ground,
    "stereo": _stereo,
    "rover": _rover,
    "photographs": _photographs,
    "results": _results,
    "study": _study,
    "run": _run,
    "bags": _bags,
    "foreign": _foreign,
    "training": _training,
}
