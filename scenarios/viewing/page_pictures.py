"""Pictures of a run, read back from the page that shows them."""

from __future__ import annotations

import base64
import binascii
import html
import json
import re
import zlib
from pathlib import Path
from typing import Any, Final

import numpy as np

from scenarios.player.playback import Picture

_ELEMENT: Final = re.compile(r'<(\w+)[^>]* id="playback-(table|numbers|pictures)">(.*?)</\1>', re.DOTALL)
_MOST: Final = 200_000_000  # bytes of a page, or of its numbers, that are read


def pictures_of_page(path: Path) -> tuple[Picture, ...]:
    """The pictures with their strokes; none if the page is missing, or is not of this version."""
    try:
        with path.open(encoding="utf-8") as file:
            text = file.read(_MOST)
        parts = {match[2]: match[3] for match in _ELEMENT.finditer(text)}
        table = json.loads(html.unescape(parts["table"]))["runs"][0]["pictures"]
        data = zlib.decompressobj(wbits=31).decompress(base64.b64decode(parts["numbers"]), _MOST)
        return _pictures(table, data, parts["pictures"].split("\n"))
    except (OSError, KeyError, IndexError, TypeError, ValueError, binascii.Error, zlib.error):
        return ()


def _pictures(table: dict[str, Any], data: bytes, lines: list[str]) -> tuple[Picture, ...]:
    place, counts = table["strokes"], table["counts"]
    strokes = np.frombuffer(data, "<i2", place["count"], place["at"]).reshape(-1, 4).astype(np.float32) / 8.0 - 0.5
    ends = np.cumsum([0, *counts])
    pictures = []
    for k, time in enumerate(table["times"]):
        jpeg = base64.b64decode(lines[table["first"] + k], validate=True)
        caption = table["captions"][k] if table["captions"] else ""
        drawn = tuple(table["lines"][k]) if table["lines"] else ()
        pictures.append(Picture(float(time), jpeg, strokes[ends[k] : ends[k + 1]], str(caption), drawn))
    return tuple(pictures)
