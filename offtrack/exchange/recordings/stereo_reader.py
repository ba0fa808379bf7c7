"""Reader of a stereo recording: frames, calibration, pose on the trailer, and trajectories of the camera.

Poses are those of the left camera (x right, y down, z ahead) relative to its first frame.
"""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from estimators.calibration.rectification import Rectifier
from estimators.estimates import Health, Motion
from estimators.rigid_motion import chained, stretched
from offtrack.exchange.recordings.calibrations.found import SUFFIXES, foreign_files, foreign_rig
from offtrack.exchange.recordings.calibrations.kitti import read_projections
from offtrack.exchange.recordings.camera_files import MountingOptions, Rig, facing_by_motion, mounting, read_rig
from offtrack.exchange.recordings.image_checks import image_warnings, lens_warnings, projection_warnings
from offtrack.exchange.recordings.layouts.folders import FOLDERS, find_sequence
from offtrack.exchange.recordings.stereo_sequence import Dropped, FrameFiles, StereoSequence, image_size, read_frame
from sensors.camera.rig import RawStereoRig, StereoCalibration, load_raw_rig
from sensors.messages import StereoFrame
from vehicle.foundation.user_file import MAX_FRAMES, FileKind, read_text
from vehicle.frames import FloatArray, inverse, is_rotation, orthonormalised, transform

_BASELINES = 0.005, 5.0  # [m]
_OF_DAY = "calib_cam_to_cam.txt"
_SAMPLES = 3  # places in a recording at which images are checked
_KEPT = 8  # frames that are not read again
_LEVEL = 0.5  # largest sine of the angle between horizon and optical axis of cameras that see the ground below
_FARTHEST = 1e8  # position, in any map [m]


def camera_poses(ticks: Sequence[int], motions: Sequence[Motion]) -> FloatArray:
    """Poses X_C0C (n, 4, 4) of the left camera at these ticks.

    A lost motion is replaced by one at the last velocity, until a later motion that starts before it corrects the pose.
    Poses at ticks without a motion are interpolated at constant velocity; before the first motion and after the last
    one the pose is constant.
    """
    known = _chained(motions)
    ticks_known = np.array(sorted(known), dtype=np.int64)
    poses = np.tile(np.eye(4), (len(ticks), 1, 1))
    for pose, tick in zip(poses, ticks, strict=True):
        if tick in known:
            pose[:] = known[tick]
        elif len(ticks_known) and tick > ticks_known[0]:
            after = int(np.searchsorted(ticks_known, tick))
            before = int(ticks_known[after - 1])
            pose[:] = known[before]
            if after < len(ticks_known):
                ratio = (tick - before) / (int(ticks_known[after]) - before)
                pose[:] = pose @ stretched(inverse(pose) @ known[int(ticks_known[after])], ratio)
    return poses


def _chained(motions: Sequence[Motion]) -> dict[int, FloatArray]:
    """Poses X_C0C by tick."""
    poses: dict[int, FloatArray] = {}
    last: Motion | None = None
    for motion in motions:
        X_PC = motion.X_PC
        if motion.health is not Health.LOST:
            last = motion
        elif last is not None:
            X_PC = stretched(last.X_PC, (motion.tick - motion.previous_tick) / (last.tick - last.previous_tick))
        start = poses.setdefault(motion.previous_tick, np.eye(4) if not poses else poses[max(poses)])
        poses[motion.tick] = chained(start, X_PC)
    return poses


def tum_text(times: Sequence[float], poses: FloatArray) -> str:
    """One line ``time x y z q_x q_y q_z q_w`` per pose, in s and m."""
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    rows = np.column_stack([poses[:, :3, 3], quaternions])
    lines = [f"{t:.6f} " + " ".join(f"{value:.9f}" for value in row) for t, row in zip(times, rows, strict=True)]
    title = "# time [s], position [m] and quaternion (x y z w) of the left camera in its first pose"
    return "\n".join([title, *lines, ""])


def kitti_text(poses: FloatArray) -> str:
    """One line per pose: the 12 numbers of its 3x4 matrix, row by row."""
    return "".join(" ".join(f"{value:.12e}" for value in pose[:3].ravel()) + "\n" for pose in poses)


def read_kitti_poses(path: Path, lines: int) -> FloatArray:
    """Read poses (n, 4, 4) from a file with one line of 12 numbers per frame.

    Raises:
        ValueError: one line, if a line has another form, or if the numbers of lines and frames differ.
    """
    text = read_text(path, FileKind.TABLE).splitlines()
    if len(text) > MAX_FRAMES:
        raise ValueError(f"{path} has {len(text)} lines: a recording must have at most {MAX_FRAMES} frames")
    poses = [_pose(path, k, line.split()) for k, line in enumerate(text, start=1) if line.strip()]
    if not lines <= len(poses) <= lines + 1:  # an interrupted recording may have one more
        raise ValueError(f"{path} has {len(poses)} poses for {lines} frames: repair it or remove it")
    return np.array(poses)


def _pose(path: Path, number: int, row: list[str]) -> FloatArray:
    try:
        matrix = np.array([float(value) for value in row]).reshape(3, 4)
    except ValueError:
        raise ValueError(f"{path}, line {number}: a pose is 12 numbers, the 3x4 matrix row by row") from None
    if not np.all(np.abs(matrix) <= _FARTHEST):
        raise ValueError(f"{path}, line {number}: numbers must be finite, positions within {_FARTHEST:g} m")
    if not is_rotation(matrix[:, :3], 1e-2):  # benchmark files are good to 1e-6
        raise ValueError(f"{path}, line {number}: the first three columns are not a rotation")
    return transform(orthonormalised(matrix[:, :3]), matrix[:, 3])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording:
    """A stereo sequence with its calibration and mounting."""

    sequence: StereoSequence
    source: str  # folder or bag as the user named it
    size: tuple[int, int]  # of all images [px]
    calibration: StereoCalibration  # of the rectified pair
    rectification: Rectifier | None  # None: the images are rectified already
    seen: Mapping[FrameFiles, StereoFrame | Dropped]  # frames that were looked at, as they are
    follow_distance: float  # hitch to follow point [m]
    roll_axis_height: float  # of the axis about which the trailer's body rolls [m]
    direction_std: float  # 1 sigma of the left camera's direction in the trailer [rad]
    poses: FloatArray | None  # (n, 4, 4) true poses of the left camera relative to the first frame
    warnings: tuple[str, ...]  # on images and calibration that hardly belong together
    notes: tuple[str, ...]  # on irregularities of the recording
    assumed: tuple[str, ...]  # assumptions on the mounting in words

    def probe(self) -> dict[str, Any]:
        """What was recognised, for JSON: images, calibration and mounting, and warnings, assumptions and notes."""
        frames, calibration = self.sequence.frames, self.calibration
        duration = frames[-1].time - frames[0].time
        images = {
            "left": self.sequence.folders.left,
            "right": self.sequence.folders.right,
            "frames": len(frames),
            "width_px": self.size[0],
            "height_px": self.size[1],
            "duration_s": round(duration, 6),
            "rate_hz": round((len(frames) - 1) / duration, 3) if duration > 0.0 else None,
        }
        cameras = {
            "rectified": self.rectification is None,
            "focal_length_px": round(calibration.focal_length, 3),
            "cx_px": round(calibration.cx, 3),
            "cy_px": round(calibration.cy, 3),
            "baseline_m": round(calibration.baseline, 6),
        }
        mounting = {
            "X_SC": np.round(calibration.X_SC, 6).tolist(),
            "follow_distance_m": self.follow_distance,
            "direction_std_deg": round(math.degrees(self.direction_std), 4),
            "true_poses": self.poses is not None,
        }
        return {
            "recording": {"images": images, "calibration": cameras, "mounting": mounting},
            **{name: list(getattr(self, name)) for name in ("warnings", "assumed", "notes")},
        }

    def rectified(self, frame: StereoFrame) -> StereoFrame:
        """Rectified frame, as the calibration describes it."""
        return self.rectification.step(frame) if self.rectification else frame


class _Cameras(NamedTuple):
    """Contents of a recording's calibration files."""

    calibration: StereoCalibration  # of the rectified pair; its X_SC is replaced by the mounting
    rectification: Rectifier | None
    rig: Rig
    X_CP: FloatArray  # (4, 4) pose in the rectified left camera of the camera whose poses are in ``poses.txt``
    raw: RawStereoRig | None = None  # as calibrated


def open_recording(
    directory: Path,
    *,
    calibration_file: Path | None = None,
    rate_hz: float | None = None,
    options: MountingOptions | None = None,
    folders: tuple[str, str] | None = None,
    exchange: bool = False,
) -> Recording:
    """Open the recording in a folder; a few of its images are read to check them.

    Args:
        directory: contains two folders of images, ``times.txt`` and ``calib.txt``. ``rig.toml`` has the pose of the
            cameras and, for raw images, their calibration in place of ``calib.txt``; ``poses.txt`` has true poses.
        calibration_file: overrides the calibration in the folder; TOML, YAML and XML files describe raw images.
        rate_hz: replaces ``times.txt``.
        options: override ``rig.toml``.
        folders: names of the folders of left and right images, instead of those of a known layout.
        exchange: takes the right images for left ones.

    Raises:
        ValueError: one line naming the wrong file and the remedy.
    """
    sequence = find_sequence(directory, rate_hz, folders=folders, exchange=exchange)
    size = image_size(sequence)
    return _opened(sequence, size, str(directory), calibration_file, options or MountingOptions())


def live_recording(calibration_file: Path, size: tuple[int, int], options: MountingOptions) -> Recording:
    """Recording without frames, of cameras whose images come one after the other, of this width and height [px].

    Raises:
        ValueError: one line naming the wrong file and the remedy.
    """
    nothing = StereoSequence(directory=calibration_file.parent, folders=FOLDERS[0], frames=(), lines=0)
    return _opened(nothing, size, "live", calibration_file, options)


def _opened(
    sequence: StereoSequence, size: tuple[int, int], source: str, file: Path | None, options: MountingOptions
) -> Recording:
    cameras = _cameras(sequence, size, file)
    calibration = cameras.calibration
    if not _BASELINES[0] <= calibration.baseline <= _BASELINES[1]:
        raise ValueError(
            f"{file or source}: baseline {calibration.baseline:g} m must be {_BASELINES[0]:g} to {_BASELINES[1]:g} m: "
            "is the calibration in mm or cm? Positions must be in metres"
        )

    seen: dict[FrameFiles, StereoFrame | Dropped] = {}

    @lru_cache(maxsize=_KEPT)
    def frame(k: int) -> StereoFrame | None:
        """The k-th rectified frame; None if there is none or it can not be used."""
        if not 0 <= k < len(sequence.frames):
            return None
        files = sequence.frames[k]
        found = seen.get(files) or read_frame(files, size)
        if len(seen) < _KEPT:
            seen[files] = found
        if not isinstance(found, StereoFrame):
            return None
        return cameras.rectification.step(found) if cameras.rectification else found

    readable = filter(None, map(frame, range(len(sequence.frames))))
    facing = partial(facing_by_motion, calibration, readable, upside_down=options.upside_down)
    mounted = mounting(options, cameras.rig, calibration, facing)
    last = max(1, len(sequence.frames) - 2)
    places = [lambda step, k=k: frame(k + step) for k in np.unique(np.linspace(1, last, _SAMPLES).astype(int)).tolist()]
    ground_below = abs(mounted.X_SC[2, 2]) < _LEVEL and not options.upside_down
    warnings = projection_warnings(calibration, cameras.raw) + image_warnings(places, ground_below=ground_below)
    if cameras.rectification:
        raw = [one for one in seen.values() if isinstance(one, StereoFrame)][-_SAMPLES:]
        warnings += lens_warnings(raw, list(map(cameras.rectification.step, raw)))
    return Recording(
        sequence=sequence,
        source=source,
        size=size,
        calibration=replace(calibration, X_SC=mounted.X_SC),
        rectification=cameras.rectification,
        seen=seen,
        follow_distance=mounted.follow_distance,
        roll_axis_height=mounted.roll_axis_height,
        direction_std=mounted.direction_std,
        poses=_poses(sequence, cameras.X_CP) if sequence.frames else None,
        warnings=tuple(warnings),
        notes=sequence.notes,
        assumed=mounted.assumed,
    )


def _cameras(sequence: StereoSequence, size: tuple[int, int], file: Path | None) -> _Cameras:
    """Cameras from the option's file, else from the ``rig.toml`` of raw images, ``calib.txt``, or another program's."""
    own_rig = sequence.directory / "rig.toml"
    rig = read_rig(own_rig) if os.path.lexists(own_rig) else Rig()
    if file is None and rig.raw:
        file = own_rig
    if file is not None and file.suffix == ".toml":
        given = read_rig(file)
        rig = Rig(
            X_SC=rig.X_SC if given.X_SC is None else given.X_SC,
            follow_distance=given.follow_distance or rig.follow_distance,
            roll_axis_height=given.roll_axis_height or rig.roll_axis_height,
            direction_std=rig.direction_std if given.direction_std is None else given.direction_std,
        )
        return _raw_cameras(file, size, load_raw_rig(file), rig)
    projections = file or _projections(sequence)
    foreign: tuple[Path, ...] = (projections,) if projections.suffix in SUFFIXES else ()
    if file is None and not os.path.lexists(projections):
        foreign = foreign_files(sequence.directory / sequence.folders.left, sequence.directory / sequence.folders.right)
    if foreign:
        return _raw_cameras(foreign[0], size, foreign_rig(foreign, size), rig)
    calibration = read_projections(projections, sequence.folders, size)
    X_CP = inverse(calibration.X_SC)
    return _Cameras(replace(calibration, X_SC=np.eye(4)), None, rig, X_CP)


def _projections(sequence: StereoSequence) -> Path:
    """The folder's ``calib.txt``, or that of KITTI's raw data, which lies beside the drives of a day."""
    own = sequence.directory / "calib.txt"
    places = own, sequence.directory / _OF_DAY, sequence.directory.resolve().parent / _OF_DAY
    return next((path for path in places if os.path.lexists(path)), own)


def _raw_cameras(path: Path, size: tuple[int, int], raw: RawStereoRig, rig: Rig) -> _Cameras:
    for side, camera in (("left", raw.left), ("right", raw.right)):
        if (camera.width, camera.height) != size:
            lacks = f"{path}: the {side} camera has {camera.width}x{camera.height} px, the images {size[0]}x{size[1]}"
            raise ValueError(f"{lacks}: is it the calibration of these images?")
    if rig.X_SC is not None:
        raw = replace(raw, X_SC=rig.X_SC)
    rectifier = Rectifier(raw)
    X_SC = rectifier.calibration.X_SC
    rig = replace(rig, X_SC=None if rig.X_SC is None else X_SC)
    return _Cameras(rectifier.calibration, rectifier, rig, inverse(X_SC) @ raw.X_SC, raw)


def _poses(sequence: StereoSequence, X_CP: FloatArray) -> FloatArray | None:
    """True poses X_C0C of the frames, from a file with the poses of a camera P at X_CP on the same rig."""
    benchmark = sequence.directory.resolve().parent.parent / "poses" / f"{sequence.directory.resolve().name}.txt"
    path = next((p for p in (sequence.directory / "poses.txt", benchmark) if os.path.lexists(p)), None)
    if path is None:
        return None
    X_WP = read_kitti_poses(path, sequence.lines)
    X_WC = X_WP[[files.line for files in sequence.frames]] @ inverse(X_CP)
    poses: FloatArray = inverse(X_WC[0]) @ X_WC
    return poses
