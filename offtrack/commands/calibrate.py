"""`offtrack calibrate`: calibrate a camera or a stereo pair with photographs of a checkerboard."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.table import Table

from offtrack.commands.console import PlainConsole, one_line_errors, progress_bar, progress_display

if TYPE_CHECKING:
    from estimators.calibration.boards import BoardView, CameraCalibration, StereoFit

EXAMPLES = (
    "Examples: offtrack calibrate photos/   "
    "offtrack calibrate stereo_photos/ --board 9x6 --square 0.04 --position=-14,0.25,3   "
    "offtrack calibrate left/*.png --right right/"
)


def calibrate(
    images: Annotated[
        list[Path],
        typer.Argument(
            help="Photographs of the board, or folders of them. One folder with left/ and right/ is a stereo pair."
        ),
    ],
    right: Annotated[
        list[Path] | None,
        typer.Option(help="Images of the right camera or their folder, in the same order. May be repeated."),
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
    quiet: Annotated[bool, typer.Option("--quiet", help="Print no progress bar and no tables.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON and nothing else.")] = False,
) -> None:
    """Calibrate a camera or a stereo pair with photographs of a checkerboard.

    Use the file of a stereo pair as `offtrack estimate off-tracking --calibration FILE`.
    """
    from estimators.calibration.boards import calibrated, calibrated_pair
    from offtrack.exchange.recordings.calibration_files import (
        board_of,
        camera_text,
        coverage_picture,
        photographs,
        views_of,
    )
    from scenarios.results.atomic_files import check_new_file, replaced
    from sensors.camera.lens import RawStereoRig
    from vehicle.foundation.quantity import check_number

    with one_line_errors():
        check_number("--square", square, 1e-4, 10.0, "m")
        checkerboard, X_SC = board_of(board, square), _mount(facing, position)
        left_paths, right_paths = photographs(images, right or [])
        target = out or Path("rig.toml" if right_paths else "camera.toml")
        check_new_file(target)
        shown = not (quiet or as_json)
        cameras, sides = {}, []
        with progress_display(shown=shown and sys.stderr.isatty()) as display:
            for name, paths in _named(left_paths, right_paths).items():
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
            typer.echo(json.dumps(_numbers(cameras, pair) | {"file": str(target)}, indent=2))
        elif not quiet:
            _print_tables(cameras, pair, sides)
            console = PlainConsole()
            console.print(f"Written: {target}, {picture}", soft_wrap=True)
            if pair and position is None:
                console.print(
                    "The cameras' pose on the trailer (X_SC in the file) is assumed: set --facing and --position.",
                    soft_wrap=True,
                )


def _named(left: list[Path], right: list[Path]) -> dict[str, list[Path]]:
    return {"left": left, "right": right} if right else {"camera": left}


def _mount(facing: Literal["rear", "left", "right", "down"], position: str | None) -> Any:
    """Pose X_SC (4, 4) of a camera without pitch and roll."""
    from sensors.camera.rig import StereoRig
    from vehicle.foundation.quantity import check_number

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


def _print_tables(
    cameras: dict[str, CameraCalibration], pair: StereoFit | None, sides: Sequence[Sequence[BoardView]]
) -> None:
    console = PlainConsole()
    for (name, calibration), views in zip(cameras.items(), sides, strict=False):
        console.print(_image_table(name, calibration, views))
    console.print(_parameter_table(cameras))
    if pair:
        x, y, z = pair.X_ClCr[:3, 3]
        console.print(
            f"Pair: right camera at {x:.4f}, {y:.4f}, {z:.4f} m (+-{1e3 * pair.position_std:.1f} mm), angles "
            f"+-{math.degrees(pair.rotation_std):.3f} deg; {len(pair.errors)} pairs, {pair.rms:.3f} px RMS",
            soft_wrap=True,
        )


def _image_table(name: str, calibration: CameraCalibration, views: Sequence[BoardView]) -> Table:
    table = Table(
        title=f"{name}: {len(calibration.errors)} of {len(views)} images used, {calibration.rms:.3f} px RMS",
        title_justify="left",
    )
    table.add_column("image")
    table.add_column("error [px]", justify="right")
    table.add_column("reason if dropped")
    for view in views:
        error = calibration.errors.get(view.name)
        table.add_row(view.name, "-" if error is None else f"{error:.3f}", calibration.dropped.get(view.name, ""))
    return table


def _parameter_table(cameras: dict[str, CameraCalibration]) -> Table:
    table = Table(title="Parameters of each camera, with standard deviations", title_justify="left")
    table.add_column("")
    for name in cameras:
        table.add_column(name, justify="right")
        table.add_column("+-", justify="right")
    names = ("fx [px]", "fy [px]", "cx [px]", "cy [px]", "k1", "k2", "p1", "p2", "k3")
    for k, name in enumerate(names):
        digits, cells = 2 if k < 4 else 5, []
        for calibration in cameras.values():
            camera = calibration.camera
            value = (camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion)[k]
            cells += [f"{value:.{digits}f}", f"{calibration.std[k]:.{digits}f}"]
        table.add_row(name, *cells)
    return table
