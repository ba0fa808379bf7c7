"""A playback as text for a page: signals as gzipped numbers, pictures made small, and the player's own files.

Signals are 32-bit floats, strokes over pictures 16-bit integers; both stand in one block of bytes, little-endian,
compressed and in base64. Each picture is a line of base64. All rows with a sparse signal's value are kept; of the
others, as many as have room.
"""

import base64
import gzip
import io
import json
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from offtrack.reports.player.playback import Body, Picture, Playback, PlayedRun
from scenarios.image_file import PictureSize
from scenarios.results.log import Log
from scenarios.results.trailer_result import FrictionPicture
from vehicle.frames import FloatArray

STROKES: Final = 160  # over a picture
ON_PAGE: Final = PictureSize(672, 50)
_SIZES: Final = (ON_PAGE, (560, 45), (480, 42), (416, 40))  # width [px] and JPEG quality, best first
_TRIED: Final = 8  # pictures whose size is measured
_HALVED: Final = {1: cv2.IMREAD_COLOR, 2: cv2.IMREAD_REDUCED_COLOR_2, 4: cv2.IMREAD_REDUCED_COLOR_4}
_MARGIN: Final = 1.1  # pictures that were not tried may be larger


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SmallPicture:
    """A picture as it is on the page."""

    picture: Picture
    jpeg: bytes
    scale: float  # of its pixels to those of the original


def small_pictures(pictures: Sequence[Picture], room: int) -> tuple[list[SmallPicture], str]:
    """Pictures that take up at most about ``room`` bytes, and a sentence on what was left out; empty if nothing was.

    A picture that can't be decoded is left out.
    """
    if not pictures:
        return [], ""
    tried = pictures[:: max(1, len(pictures) // _TRIED)]
    for width, quality in _SIZES:
        sizes = [len(small.jpeg) for small in (_small(one, width, quality) for one in tried) if small]
        whole = _MARGIN * float(np.mean(sizes or [0])) * len(pictures)
        if whole <= room:
            break
    stride = max(1, int(np.ceil(whole / max(room, 1))))
    kept = pictures[::stride]
    with ThreadPoolExecutor(max_workers=min(4, os.cpu_count() or 1)) as pool:  # OpenCV works outside Python's lock
        small = [one for one in pool.map(lambda picture: _small(picture, width, quality), kept) if one]
    left_out = f" Every {_ordinal(stride)} of them is shown." if stride > 1 else ""
    return small, f"{len(pictures)} pictures of the camera, {width} px wide at most.{left_out}"


def _small(picture: Picture, width: int, quality: int) -> SmallPicture | None:
    data = np.frombuffer(picture.jpeg, np.uint8)
    try:
        original = Image.open(io.BytesIO(picture.jpeg)).width  # reads the header alone
    except OSError:
        return None
    if original <= width:
        return SmallPicture(picture=picture, jpeg=picture.jpeg, scale=1.0)
    factor = max((k for k in _HALVED if original >= k * width), default=1)
    image = cv2.imdecode(data, _HALVED[factor])
    if image is None:
        return None
    if image.shape[1] > 1.05 * width:
        size = (width, max(1, round(width * image.shape[0] / image.shape[1])))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
    return SmallPicture(picture=picture, jpeg=jpeg, scale=image.shape[1] / original)


def live_picture(picture: Picture) -> dict[str, Any]:
    """A picture as a page gets it while the run goes on, ready for JSON."""
    small = _small(picture, *_SIZES[0])
    return {
        "time": picture.time,
        "base64": base64.b64encode(small.jpeg).decode() if small else "",
        "caption": picture.caption,
        "strokes": strokes_of(small, STROKES).ravel().tolist() if small else [],
        "lines": list(picture.lines),
    }


def strokes_of(small: SmallPicture, most: int) -> NDArray[np.int16]:
    """Strokes on the small picture in eighths of its pixels, (n, 4); of more than ``most`` every second, third, …."""
    strokes = small.picture.strokes
    if not small.picture.lines and len(strokes) > most:
        strokes = strokes[:: -(-len(strokes) // most)]
    eighths: NDArray[np.int16] = np.clip(np.rint(8.0 * small.scale * (strokes + 0.5)), -32768, 32767).astype(np.int16)
    return eighths


def _ordinal(n: int) -> str:
    return {2: "second", 3: "third"}.get(n, f"{n}th")


LIMIT: Final = 13_000_000  # characters of a page's playback
_VALUES: Final = 1_500_000  # of all signals of all runs
_SPARSE: Final = 0.5  # share of rows with a value, below which a signal is sparse
_LINE_POINTS: Final = 4000  # of a fixed line


@dataclass(frozen=True, slots=True)
class EncodedPlayback:
    """Texts that a page embeds."""

    title: str
    table: str  # JSON; a template escapes it
    numbers: str  # base64 of gzipped bytes
    pictures: str  # a line of base64 for each picture


class _Block:
    """Arrays one after the other; the table holds their places."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._length = 0

    def add(self, values: NDArray[Any], kind: str) -> dict[str, Any]:
        data = np.ascontiguousarray(values, dtype=kind).tobytes()
        place = {"at": self._length, "count": int(values.size), "kind": kind[1:]}
        data += b"\0" * (-len(data) % 4)  # views of 32-bit numbers begin at multiples of 4
        self._parts.append(data)
        self._length += len(data)
        return place

    def text(self) -> str:
        return base64.b64encode(gzip.compress(b"".join(self._parts), 6, mtime=0)).decode()


def encoded(playback: Playback, limit: int = LIMIT, values: int = _VALUES) -> EncodedPlayback:
    """The playback as texts of at most about ``limit`` characters, with about ``values`` values of the signals."""
    block = _Block()
    values //= max(1, len(playback.runs))
    runs = [_run(run, block, values) for run in playback.runs]
    road, friction = playback.road, playback.friction
    table = {
        "title": playback.title,
        "things": [_line(outline, block) for outline in playback.things],
        "road": None if road is None else {"left": _line(road.left, block), "right": _line(road.right, block)},
        "together": playback.together,
        "friction": None if friction is None else _friction(friction),
        "charts": [
            chart._asdict() | {"curves": [curve._asdict() for curve in chart.curves]} for chart in playback.charts
        ],
        "readings": [reading._asdict() for reading in playback.readings],
        "nearest": playback.nearest,
    }
    room = int(0.74 * (limit - 1.35 * (block._length // 2)))  # of their bytes in base64; numbers compress to half
    pictures, note = _pictures(playback, runs, block, max(room, 0))
    table |= {"runs": runs, "note": note}
    text = json.dumps(table, separators=(",", ":"), allow_nan=False)
    return EncodedPlayback(playback.title, text, block.text(), "\n".join(pictures))


def _run(run: PlayedRun, block: _Block, values: int) -> dict[str, Any]:
    log, rows = run.log, kept_rows(run.log, values)
    signals = list[dict[str, Any]]()
    seen = dict[bytes, dict[str, Any]]()  # the last trailer's signals stand in a log twice
    for signal in log.signals:
        column = log[signal.name][rows]
        if signal.name != "time" and not np.isfinite(column).any():
            continue
        data = column.astype("<f4")
        place = seen.setdefault(data.tobytes(), {}) or block.add(data, "<f4")
        seen[data.tobytes()] = place
        signals.append({"name": signal.name, "unit": signal.unit, "meaning": signal.description, "values": place})
    return {
        "name": run.name,
        "link": run.link,
        "peak": [run.peak.time, run.peak.size],
        "rows": len(rows),
        "all_rows": len(log),
        "signals": signals,
        "bodies": [_body(body) for body in run.bodies],
        "trails": [trail._asdict() for trail in run.trails],
        "estimated": None if run.estimated is None else run.estimated._asdict(),
        "spans": [span._asdict() for span in run.spans],
        "lines": [line._asdict() | {"points": _line(line.points, block)} for line in run.lines],
        "cameras": [camera._asdict() | {"X_BC": camera.X_BC.tolist()} for camera in run.cameras],
    }


def kept_rows(log: Log, values: int) -> NDArray[np.intp]:
    """Rows of a log whose numbers have room: all with a sparse signal's value, the last, and of the others as many."""
    if not len(log):
        return np.zeros(0, dtype=np.intp)
    known = np.isfinite(log.rows)
    share = known.mean(axis=0)
    sparse = known[:, (share > 0.0) & (share < _SPARSE)].any(axis=1)
    stride = max(1, -(-log.rows.size // values))
    every = np.arange(len(log)) % stride == 0
    every[-1] = True
    return np.flatnonzero(every | sparse)


def _body(body: Body) -> dict[str, Any]:
    return {
        "name": body.name,
        "outline": body.outline.tolist(),
        "wheels": [wheel._asdict() for wheel in body.wheels],
        "pose": body.pose,
        "tilt": body.tilt,
        "heights": body.heights,
    }


def _line(points: FloatArray, block: _Block) -> dict[str, Any]:
    thinned = points[:: max(1, len(points) // _LINE_POINTS)]
    if len(points) and not np.array_equal(thinned[-1], points[-1]):
        thinned = np.vstack([thinned, points[-1]])
    return block.add(thinned.astype("<f4"), "<f4")


def _friction(friction: FrictionPicture) -> dict[str, Any]:
    """Shades of the ground, as a PNG whose first row is the farthest north, white where friction is best."""
    best = float(friction.values.max())
    worst = float(friction.values.min())
    shade = np.rint(255.0 * (best - friction.values[::-1]) / max(best - worst, 1e-9)).astype(np.uint8)
    png = base64.b64encode(cv2.imencode(".png", shade)[1].tobytes()).decode()
    return {"png": png, "low": friction.low.tolist(), "high": friction.high.tolist(), "best": best, "worst": worst}


def _pictures(playback: Playback, runs: list[dict[str, Any]], block: _Block, room: int) -> tuple[list[str], str]:
    """Lines of base64; the runs' tables receive the times, strokes and captions."""
    lines, notes = list[str](), list[str]()
    count = sum(len(run.pictures) for run in playback.runs)
    for run, table in zip(playback.runs, runs, strict=True):
        small, note = small_pictures(run.pictures, room * len(run.pictures) // max(count, 1))
        notes.append(note)
        strokes = [strokes_of(one, STROKES) for one in small]
        table["pictures"] = {
            "first": len(lines),
            "times": [one.picture.time for one in small],
            "captions": [one.picture.caption for one in small] if any(one.picture.caption for one in small) else None,
            "counts": [len(one) for one in strokes],
            "strokes": block.add(np.concatenate([*strokes, np.zeros((0, 4), np.int16)]), "<i2"),
            "lines": [list(one.picture.lines) for one in small] if any(one.picture.lines for one in small) else None,
        }
        lines.extend(base64.b64encode(one.jpeg).decode() for one in small)
    rows = [f"{table['rows']} of {table['all_rows']} rows of {table['name']}" for table in runs
            if table["rows"] < table["all_rows"]]  # fmt: skip
    thinned = f"Of the signals, {', '.join(rows)} are on this page; signals.parquet has all." if rows else ""
    return lines, " ".join(filter(None, (*dict.fromkeys(notes), thinned)))


_SCRIPTS: Final = ("uPlot.iife.min", "theme", "data", "charts", "pictures", "plan", "scene", "live", "player")


@lru_cache(maxsize=1)
def player_script() -> str:
    """The script that plays a page's playback."""
    return "\n".join(['"use strict";', *(_text(f"{name}.js") for name in _SCRIPTS)])


@lru_cache(maxsize=1)
def explorer_script() -> str:
    """The script that draws the runs of a study."""
    names = ("data", "explorer")
    return "\n".join(['"use strict";', "{", *(_text(f"{name}.js") for name in names), "}"])


@lru_cache(maxsize=1)
def player_style() -> str:
    """The style sheet of the playback."""
    return _text("uPlot.min.css") + _text("player.css")


def _text(name: str) -> str:
    return (files("offtrack.reports.player") / "web" / name).read_text(encoding="utf-8")
