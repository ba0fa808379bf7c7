"""The calibration of a stereo pair by another program: its files, and which program's they are."""

from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml

from offtrack.exchange.recordings.calibrations import euroc, kalibr, opencv, ros
from scenarios.roads.path_file import read_xml
from sensors.camera.rig import RawStereoRig
from vehicle.foundation.user_file import MAX_NESTING, FileKind, read_text, shown
from vehicle.frames import orthonormalised, transform

SUFFIXES: Final = (".yaml", ".yml", ".xml")
_MOST_EVENTS: Final = 20_000  # of a YAML file


def foreign_files(left: Path, right: Path) -> tuple[Path, ...]:
    """Calibration files of other programs beside the folders of the left and the right images, or in the one above."""
    own = left.parent / "sensor.yaml", right.parent / "sensor.yaml"
    if left.parent != right.parent and all(map(Path.is_file, own)):
        return own
    for place in (left.parent, left.parent.parent):
        for pattern in ("camchain*.y*ml", "*stereo*.y*ml", "*stereo*.xml", "*intrinsics*.y*ml"):
            if found := sorted(place.glob(pattern)):
                return (found[0],)
        pair = place / "left.yaml", place / "right.yaml"
        if all(map(Path.is_file, pair)):
            return pair
    return ()


def foreign_rig(files: tuple[Path, ...], size: tuple[int, int]) -> RawStereoRig:
    """Raw stereo pair from one file, or from those of the left and the right camera; its X_SC is the identity.

    The left camera's file will do, if the right one's is found by its name, or that of its folder. ``size`` is the
    width and height [px] of the images, for files that do not say it.

    Raises:
        ValueError: one line naming the file and what is missing or wrong in it.
    """
    first = files[0]
    tables = [_table(path) for path in files]
    if (beside := first.with_name(first.name.replace("intrinsics", "extrinsics"))) != first and beside.is_file():
        tables[0] = _table(beside) | tables[0]  # of OpenCV's sample
    if len(tables) == 1 and ("camera_matrix" in tables[0] or "intrinsics" in tables[0]):
        files = first, _of_right_camera(first)
        tables.append(_table(files[1]))
    two = len(tables) == 2
    program = (euroc if "T_BS" in tables[0] else ros) if two else kalibr if "cam1" in tables[0] else opencv
    try:
        left, right, X_ClCr = program.pair(tables, size)
        R = orthonormalised(X_ClCr[:3, :3])
        return RawStereoRig(left=left, right=right, X_ClCr=transform(R, X_ClCr[:3, 3]), X_SC=np.eye(4))
    except KeyError as error:
        raise ValueError(f"{first}: {error.args[0]} is missing: is it the calibration of a stereo pair?") from None
    except (TypeError, AttributeError, IndexError) as error:
        raise ValueError(f"{first}: can not be read as the calibration of a stereo pair: {error}") from None
    except ValueError as error:
        raise ValueError(f"{' and '.join(map(str, files))}: {error}") from error


def _of_right_camera(left: Path) -> Path:
    """File of the right camera beside that of the left one: ``right.yaml``, ``cam1/sensor.yaml``."""
    for was, instead in (("left", "right"), ("cam0", "cam1")):
        for other in (left.with_name(left.name.replace(was, instead)), left.parent.with_name(instead) / left.name):
            if (was in left.name or left.parent.name == was) and other != left and other.is_file():
                return other
    raise ValueError(f"{left}: calibration of one camera, and none of the right one beside it (right.yaml, cam1)")


class _Loader(yaml.SafeLoader):  # type: ignore[misc]  # it ships no types
    """YAML with OpenCV's matrices."""


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", lambda loader, node: loader.construct_mapping(node, True))


def _check_yaml(text: str) -> None:
    """Refuse what takes the loader long: aliases, which multiply, and more than a calibration has."""
    depth = 0
    for count, event in enumerate(yaml.parse(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if isinstance(event, yaml.AliasEvent) or depth > MAX_NESTING or count > _MOST_EVENTS:
            line = f"line {event.start_mark.line + 1}: a calibration has no aliases"
            raise ValueError(f"{line}, at most {_MOST_EVENTS} values, {MAX_NESTING} deep")


def _table(path: Path) -> dict[str, Any]:
    """Contents of a YAML or XML file."""
    if path.suffix == ".xml":
        root = read_xml(path, "opencv_storage")
        return {one.name: {part.name: part.text for part in one.children} or one.text for one in root.children}
    text = read_text(path, FileKind.CALIBRATION)
    if text.startswith("%YAML"):
        text = text.partition("\n")[2]  # OpenCV writes %YAML:1.0, which is none
    try:
        _check_yaml(text)
        table = yaml.load(text, _Loader)  # a SafeLoader
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise ValueError(f"{path}: not a YAML file: {shown(' '.join(str(error).split()), 200)}") from None
    if not isinstance(table, dict):
        raise ValueError(f"{path}: has no keys: is it the calibration of a camera?")
    return table
