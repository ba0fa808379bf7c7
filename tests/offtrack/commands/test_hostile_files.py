"""Something else in place of every file that a user gives: whoever reads it refuses it at once, in one line."""

from collections.abc import Callable
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import pytest

from controllers.trailer_steering.policy import load_network
from offtrack.environments.training.training_directory import Plan, check_directory, read_curve
from offtrack.exchange.recordings.calibrations.kitti import read_projections
from offtrack.exchange.recordings.camera_files import board_of, read_rig, views_of
from offtrack.exchange.recordings.layouts.folders import FOLDERS, find_sequence
from offtrack.exchange.recordings.stereo_reader import read_kitti_poses
from offtrack.exchange.recordings.stereo_sequence import Dropped, stream
from offtrack.exchange.recordings.writers import load_rig, open_rover_recording
from offtrack.reports.vehicle_sheet.combination_sheet import open_sheet
from offtrack.studies.study import load_study
from scenarios.assembly.adapters import ground_friction
from scenarios.assembly.drivers_and_laws import read_trace
from scenarios.assembly.surrogate import load_surrogate, run_errors
from scenarios.options.scenario import load_any_scenario
from scenarios.options.tables import SurfaceOptions
from scenarios.progress import no_progress
from scenarios.results.log import read_log
from scenarios.roads.opendrive.file import read_opendrive
from scenarios.roads.path_file import read_path
from sensors.camera.rig import load_raw_rig
from tests.hostile_files import HOSTILE
from vehicle.combination.description import load_vehicle
from vehicle.rover.description import load_rover, load_soil
from vehicle.rover.terrain import load_height_map

BLACK: Final = np.zeros((6, 8), np.uint8)
ROVER_RIG: Final = """
X_RC = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.5], [0, 0, 0, 1]]
wheel = [-0.3, 0.2]
wheel_radius = 0.1
wheel_width = 0.1
wheels = [{ name = "only", x = 0.0, y = 0.0 }]
camera = { width = 8, height = 6, fx = 8.0, fy = 8.0, cx = 3.5, cy = 2.5 }
"""
READINGS: Final = "time_s,heading_deg,wheel_speed_only,steer_deg_only\n0,0,0,0\n"


def prepare(folder: Path) -> None:
    """A stereo recording of one pair, a rover's recording of one view, and the scenario of a run."""
    for side in ("left", "right", "images"):
        (folder / side).mkdir()
        cv2.imwrite(str(folder / side / "0.png"), BLACK)
    (folder / "rig.toml").write_text(ROVER_RIG, encoding="utf-8")
    (folder / "readings.csv").write_text(READINGS, encoding="utf-8")
    (folder / "scenario.toml").write_text('off_tracking = "viso_ot"\n', encoding="utf-8")


def stereo(folder: Path, rate: float | None) -> None:
    for _, frame in stream(find_sequence(folder, rate).frames, (8, 6)):
        if isinstance(frame, Dropped):
            raise ValueError(frame.reason)


def rover(folder: Path) -> None:
    view = open_rover_recording(folder).view(0)
    if isinstance(view, str):
        raise ValueError(view)


OPENED: Final[dict[str, tuple[str, Callable[[Path], object]]]] = {
    "vehicle": ("mine.toml", lambda path: load_vehicle(str(path))),
    "sheet": ("mine.toml", lambda path: open_sheet(str(path))),
    "rover": ("mine.toml", lambda path: load_rover(str(path))),
    "soil": ("mine.toml", lambda path: load_soil(str(path))),
    "scenario": ("mine.toml", lambda path: load_any_scenario(str(path))),
    "study": ("mine.toml", load_study),
    "surrogate": ("mine.toml", load_surrogate),
    "rig": ("rig.toml", read_rig),
    "raw rig": ("rig.toml", load_raw_rig),
    "rover's rig": ("rig.toml", load_rig),
    "projections": ("calib.txt", lambda path: read_projections(path, FOLDERS[0], (1241, 376))),
    "poses": ("poses.txt", lambda path: read_kitti_poses(path, 3)),
    "times": ("times.txt", lambda path: stereo(path.parent, None)),
    "recorded image": ("left/0.png", lambda path: stereo(path.parents[1], 10.0)),
    "rover's image": ("images/0.png", lambda path: rover(path.parents[1])),
    "readings": ("readings.csv", lambda path: rover(path.parent)),
    "slip": ("slip.csv", lambda path: rover(path.parent)),
    "board": ("board.jpg", lambda path: views_of([path], board_of("9x6", 0.04), no_progress)),
    "friction": (
        "friction.png",
        lambda path: ground_friction(SurfaceOptions(friction_image=str(path)), np.zeros((2, 2))),
    ),
    "trace": ("drive.csv", read_trace),
    "path": ("path.csv", read_path),
    "track": ("path.gpx", read_path),
    "line": ("path.geojson", read_path),
    "road": ("road.xodr", read_opendrive),
    "heights": ("heights.npy", lambda path: load_height_map(str(path), 0.1)),
    "heights as text": ("heights.csv", lambda path: load_height_map(str(path), 0.1)),
    "network": ("network.npz", load_network),
    "run's scenario": ("scenario.toml", lambda path: run_errors(path.parent)),
    "run's signals": ("signals.parquet", lambda path: run_errors(path.parent)),
    "log": ("signals.parquet", read_log),
    "curve": ("curve.parquet", read_curve),
    "training": ("training.json", lambda path: check_directory(Plan(), path.parent)),
}


@pytest.mark.parametrize("kind", HOSTILE)
@pytest.mark.parametrize("what", OPENED)
def test_something_else_in_place_of_a_file_is_refused_in_one_line(what: str, kind: str, tmp_path: Path) -> None:
    name, opened = OPENED[what]
    prepare(tmp_path)
    (tmp_path / name).unlink(missing_ok=True)
    HOSTILE[kind](tmp_path / name)
    with pytest.raises(ValueError, match=r"^[^\n]{1,2000}$") as refusal:
        opened(tmp_path / name)
    assert Path(name).stem in str(refusal.value)
