"""`offtrack calibrate`: cameras and stereo pairs by photographs of a board."""

import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import typer

from estimators.calibration.boards import BoardView, CameraCalibration, StereoFit, calibrated, calibrated_pair
from offtrack.commands.console import AsJson, PlainConsole, Quiet, progress_bar, progress_display, summary_table
from offtrack.exchange.recordings.camera_files import board_of, camera_text, coverage_picture, photographs, views_of
from scenarios.results.run_directory import check_new_file, replaced
from sensors.camera.rig import RawStereoRig, StereoRig
from vehicle.foundation.quantity import check_number

_PARAMETERS: Final = ("fx [px]", "fy [px]", "cx [px]", "cy [px]", "k1", "k2", "p1", "p2", "k3")
EXAMPLES: Final = (
    "Examples: offtrack calibrate photos/   "
    "offtrack calibrate stereo_photos/ --board 9x6 --square 0.04 --position=-14,0.25,3   "
    "offtrack calibrate left/*.png --right right/"
)


def calibrate(
    images: Annotated[
        list[Path],
        typer.Argument(
            help="Photographs of the board, or folders of them. One folder with left/ and right/, or with names that "
            "say left and right, is a stereo pair."
        ),
    ],
    right: Annotated[
        list[Path] | None,
        typer.Option(help="Images of the right camera or their folder; pairs are found by the numbers in the names."),
    ] = None,
    board: Annotated[str, typer.Option(help="Inner corners per row and column: one less than the squares.")] = "9x6",
    square: Annotated[float, typer.Option(help="Side length of a square [m].")] = 0.04,
    facing: Annotated[
        Literal["rear", "left", "right", "down"],
        typer.Option(help="Viewing direction of the stereo pair on the trailer."),
    ] = "rear",
    position: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z", help="Position of the left camera from the hitch [m]: ahead (negative: behind), left, up."
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Output file; it must not exist yet.", show_default="rig.toml or camera.toml")
    ] = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Calibrate a camera or a stereo pair with photographs of a checkerboard.

    Use the file of a stereo pair as `offtrack estimate off-tracking --calibration FILE`.
    """
    check_number("--square", square, 1e-4, 10.0, "m")
    checkerboard, X_SC = board_of(board, square), _mount(facing, position)
    left_paths, right_paths, notes = photographs(images, right or [])
    target = out or Path("rig.toml" if right_paths else "camera.toml")
    check_new_file(target)
    shown = not (quiet or as_json)
    cameras, sides = {}, []
    with progress_display(shown=shown and sys.stderr.isatty()) as display:
        named = {"left": left_paths, "right": right_paths} if right_paths else {"camera": left_paths}
        for name, paths in named.items():
            sides.append(views_of(paths, checkerboard, progress_bar(display, f"{name} images")))
            try:
                cameras[name] = calibrated(sides[-1], checkerboard)
            except ValueError as error:
                raise ValueError(f"{name} images: {error}" if right_paths else str(error)) from error
    pair = None
    if right_paths:
        pair = calibrated_pair(sides[0], sides[1], (cameras["left"], cameras["right"]), checkerboard)
    if pair:
        text = RawStereoRig(left=pair.left, right=pair.right, X_ClCr=pair.X_ClCr, X_SC=X_SC).to_toml()
    else:
        text = camera_text(cameras["camera"])
    picture = target.with_name(f"{target.stem}_coverage.png")
    coverage_picture(cameras, picture)
    replaced(target, text)
    if as_json:
        typer.echo(json.dumps(_numbers(cameras, pair) | {"file": str(target), "notes": notes}, indent=2))
    elif not quiet:
        console = PlainConsole()
        console.print(summary_table("Calibration, with standard deviations", _tables(cameras, pair, sides)))
        of_cameras = (f"{name}: {calibration.note}" for name, calibration in cameras.items() if calibration.note)
        for note in (*notes, *of_cameras):
            console.print(f"Note: {note}", soft_wrap=True)
        console.print(f"Written: {target}, {picture}", soft_wrap=True)
        if pair and position is None:
            console.print(
                "The cameras' pose on the trailer (X_SC in the file) is assumed: set --facing and --position.",
                soft_wrap=True,
            )


def _mount(facing: Literal["rear", "left", "right", "down"], position: str | None) -> Any:
    """Pose X_SC (4, 4) of a camera without pitch and roll."""
    try:
        x, y, z = (float(part) for part in (position or "0,0,3").split(","))
    except ValueError as error:
        raise ValueError(
            f"--position {position}: expected X,Y,Z in metres, for example --position=-14,0.25,3"
        ) from error
    for value in (x, y, z):
        check_number("--position", value, -100.0, 100.0, "m")
    rig = StereoRig(facing=facing, width=1, height=1, hfov=1.0, x=x, y=y, z=z, baseline=1.0)
    X_SC = rig.calibration().X_SC.copy()
    X_SC[:3, 3] = x, y, z
    return X_SC


def _numbers(cameras: dict[str, CameraCalibration], pair: StereoFit | None) -> dict[str, Any]:
    numbers: dict[str, Any] = {
        name: {
            "rms_px": calibration.rms,
            "images": len(calibration.errors),
            "coverage": calibration.coverage,
            "errors_px": calibration.errors,
            "dropped": calibration.dropped,
            "note": calibration.note,
        }
        | {key: getattr(calibration.camera, key) for key in ("fx", "fy", "cx", "cy", "distortion")}
        | {"std": calibration.std.tolist()}
        for name, calibration in cameras.items()
    }
    if pair:
        numbers["pair"] = {
            "rms_px": pair.rms,
            "pairs": len(pair.errors),
            "X_ClCr": pair.X_ClCr.tolist(),
            "rotation_std_deg": math.degrees(pair.rotation_std),
            "position_std_m": pair.position_std,
            "errors_px": pair.errors,
            "dropped": pair.dropped,
        }
    return numbers


def _tables(
    cameras: dict[str, CameraCalibration], pair: StereoFit | None, sides: Sequence[Sequence[BoardView]]
) -> dict[str, dict[str, Any]]:
    """What is shown on the terminal: parameters with standard deviations, and the error of each image."""
    groups: dict[str, dict[str, Any]] = {}
    for (name, calibration), views in zip(cameras.items(), sides, strict=True):
        camera = calibration.camera
        values = dict(zip(_PARAMETERS, (camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion), strict=True))
        used = {"images used": f"{len(calibration.errors)} of {len(views)}", "RMS [px]": calibration.rms}
        digits = [2 if "px" in key else 5 for key in values]
        stds = zip(values.items(), calibration.std.tolist(), digits, strict=True)
        groups[name] = used | {key: f"{value:.{n}f} +- {std:.{n}f}" for (key, value), std, n in stds}
        errors = {one: f"{error:.3f} px" for one, error in calibration.errors.items()} | calibration.dropped
        groups[f"{name} images"] = {view.name: errors.get(view.name, "-") for view in views}
    if pair:
        x, y, z = pair.X_ClCr[:3, 3]
        std = f"+-{1e3 * pair.position_std:.1f} mm, angles +-{math.degrees(pair.rotation_std):.3f} deg"
        place = {"right camera": f"{x:.4f}, {y:.4f}, {z:.4f} m", "known to": std}
        groups["pair"] = {"pairs": len(pair.errors), "RMS [px]": pair.rms} | place
    return groups
