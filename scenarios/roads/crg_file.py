"""Read the measured surface of a road from an OpenCRG file, by the package pyopencrg."""

import math
import os
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import scipy
from numpy.typing import NDArray

from scenarios.extras import check_extra
from vehicle.foundation.quantity import check_number
from vehicle.foundation.temporary import temporary_folder
from vehicle.foundation.user_file import FileKind, read_bytes, shown
from vehicle.frames import FloatArray

_MOST_MISSING: Final = 0.5  # share of heights that a file may lack
_LENGTH: Final = (1.0, 50e3)  # of the grid [m]
_WIDTH: Final = (0.2, 100.0)  # [m]
_STEP: Final = (1e-3, 100.0)  # between heights along the road [m]
_COARSEST: Final = 1.0  # between those whose straight connections take the place of wider ones [m]
_MOST_HEIGHTS: Final = 32_000_000
_FINEST: Final = 0.04  # of heights, whose means take the place of finer ones: tyres average over 0.2 m [m]
_MOST_REFERENCES: Final = 8
_BLOCK: Final = re.compile(  # that may stand beside a reference to another file
    r"^\$ROAD_CRG_(FILE|OPTS|MODS)[^\n]*\n(.*?)^\$(?!\$\w)", re.IGNORECASE | re.MULTILINE | re.DOTALL
)
_FINEST_ACROSS: Final = 0.01  # of grids that are brought to an even spacing [m]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CrgSurface:
    """Heights of a road on a grid: u along its reference line, v to the left."""

    heights: FloatArray  # (nu, nv) [m], all finite
    u_start: float  # of the first heights, from the begin of the reference line [m]
    u_step: float  # [m]
    v: FloatArray  # (nv,) evenly spaced, rising [m]
    line: FloatArray  # reference line (n, 2) in the file's plane, ``line_step`` apart [m]
    line_step: float  # [m]
    missing: float  # share of heights that the file lacked: filled from their neighbours across the road

    @property
    def length(self) -> float:
        """Length along the reference line [m]."""
        return (len(self.line) - 1) * self.line_step


def read_crg(path: Path) -> CrgSurface:
    """Surface of an OpenCRG file, text or binary, with its slope, banking and modifiers.

    Missing heights (NaN) between others of a cross section are interpolated, those at its edge get the height of the
    last one, as the file's modifiers say or, if they do not, as OpenCRG's default is. A cross section without any
    height is copied from the next one.

    Raises:
        ValueError: one line naming file, value and limit.
    """
    road = _opened(path)
    v, u_step = np.asarray(road.v, dtype=np.float64), float(road.u_inc)
    missing = float(np.mean(~np.isfinite(np.asarray(road.z))))
    check_number(f"{path}: share of missing heights", missing, 0.0, _MOST_MISSING)
    check_number(f"{path}: length", (road.nu - 1) * u_step, *_LENGTH, "m")
    check_number(f"{path}: width", float(v[-1] - v[0]), *_WIDTH, "m")
    check_number(f"{path}: spacing along the road", u_step, *_STEP, "m")
    road = road.apply_mods().fill_nan(2)  # what its modifiers leave missing
    even = _even(v)
    is_even = even is v
    along, across = (
        max(1, int(_FINEST / step + 1e-6)) for step in (u_step, float(v[1] - v[0]) if is_even else _FINEST)
    )
    rows = _means(np.column_stack([np.asarray(road.zr), np.asarray(road.banking)]), along, 1)
    heights = _means(np.asarray(road.z), along, across)
    v = _means(v[None], 1, across)[0]
    heights = heights + rows[:, :1] + rows[:, 1:] * v
    if not np.isfinite(heights).all():
        raise ValueError(f"{path}: the slope or banking of its reference line is not a number everywhere")
    if not is_even:
        heights, v = np.asarray(scipy.interpolate.make_interp_spline(v, heights, k=1, axis=1)(even)), even
    finer = math.ceil(u_step / _COARSEST - 1e-9)
    return CrgSurface(
        heights=_finer(heights, finer),
        u_start=0.5 * (along - 1) * u_step,
        u_step=along * u_step / finer,
        v=v,
        line=_finer(np.column_stack([road.x, road.y]), finer),
        line_step=u_step / finer,
        missing=missing,
    )


def _finer(values: FloatArray, pieces: int) -> FloatArray:
    """Rows (n, m) with rows on the straight connections between them, so that each step has so many pieces."""
    if pieces == 1:
        return values
    at = np.arange((len(values) - 1) * pieces + 1) / pieces
    rows = np.minimum(at.astype(np.intp), len(values) - 2)
    return np.asarray(values[rows] + (at - rows)[:, None] * (values[rows + 1] - values[rows]))


def read_crg_line(path: Path) -> tuple[FloatArray, float]:
    """Reference line (n, 2) of an OpenCRG file, with its modifiers, and the spacing of its points [m].

    Raises:
        ValueError: one line, if the file cannot be read.
    """
    road = _opened(path, line_only=True)
    return np.column_stack([road.x, road.y]), float(road.u_inc)


def _opened(path: Path, *, line_only: bool = False) -> Any:
    """The package's road; with ``line_only`` flat, with its modifiers, and whatever its heights are."""
    check_extra("roads", f"{path}: OpenCRG files need", "pyopencrg")
    import pyopencrg

    named = path
    try:
        with warnings.catch_warnings(), _one_reference(path) as named:
            warnings.simplefilter("ignore")  # the package's remarks on headers, many lines
            with pyopencrg.open(str(named)) as file:
                count = int(file.nu * (2 if line_only else file.nv))
                if line_only and count <= _MOST_HEIGHTS:
                    road = file.read(step=(1, max(1, file.nv - 1)), dtype="float32", check=False)
                    road.z[:] = 0.0
                    return road.apply_mods()
            if count <= _MOST_HEIGHTS:
                return pyopencrg.read(str(named), dtype="float32")
    except _ReferenceError:
        raise
    except Exception as error:  # of any class: the package meets any bytes
        said = " ".join(str(error).removeprefix(f"{named}: ").replace("\n  -", "").split())
        said, *_ = said.split(" To open it anyway")  # by the package's functions
        raise ValueError(f"{path}: not a readable OpenCRG file: {shown(said, 200)}") from None
    raise ValueError(f"{path}: has {count} heights: must be at most {_MOST_HEIGHTS}")


class _ReferenceError(ValueError):
    """A file that a file refers to cannot be used."""


@contextmanager
def _one_reference(path: Path) -> Iterator[Path]:
    """The file, or one in its place that refers at once to the last of the files that refer to each other.

    The package follows one reference; the first options and modifiers of the chain hold.
    """
    chain, head = [path], _head(path)
    blocks = dict[str, str]()
    while "FILE" in head:
        blocks = {name: head[name] for name in ("OPTS", "MODS") if name in head} | blocks
        parts = (line.partition("!")[0].strip().replace("$$", "$") for line in head["FILE"].splitlines())
        name = "".join(part for part in parts if part[:1] != "*")
        chain.append(chain[-1].parent / os.path.expandvars(name))
        try:
            head = _head(chain[-1])
        except ValueError as error:
            raise _ReferenceError(f"{path}: refers to another file ($ROAD_CRG_FILE): {error}") from None
        if len(chain) > _MOST_REFERENCES:
            raise _ReferenceError(f"{path}: more than {_MOST_REFERENCES} files refer to each other ($ROAD_CRG_FILE)")
    if len(chain) < 3:
        yield path
        return
    with temporary_folder() as folder:
        whole = blocks | {"FILE": f"{chain[-1].resolve()}\n"}
        texts = (f"$ROAD_CRG_{name}\n{text}$\n" for name, text in whole.items())
        (folder / path.name).write_text(f"$CT\n$\n{''.join(texts)}", encoding="latin-1")
        yield folder / path.name


def _head(path: Path) -> dict[str, str]:
    """Blocks of a file's head: its reference to another file, options and modifiers."""
    text = read_bytes(path, FileKind.SURFACE)[:65_536].decode("latin-1")
    return {found[1].upper(): found[2] for found in reversed(list(_BLOCK.finditer(text)))}


def _means(values: NDArray[Any], rows: int, columns: int) -> FloatArray:
    """Means of blocks of that many rows and columns; the rest at the ends is left out."""
    n, m = (size // count for size, count in zip(values.shape, (rows, columns), strict=True))
    blocks = values[: n * rows, : m * columns].reshape(n, rows, m, columns)
    means: FloatArray = blocks.mean(axis=(1, 3), dtype=np.float64)
    return means


def _even(v: FloatArray) -> FloatArray:
    """The positions across the road, or evenly spaced ones as close as the closest of them."""
    steps = np.diff(v)
    if np.ptp(steps) <= 1e-6 * (v[-1] - v[0]):
        return v
    count = int(np.ceil((v[-1] - v[0]) / max(float(steps.min()), _FINEST_ACROSS))) + 1
    return np.linspace(v[0], v[-1], count)
