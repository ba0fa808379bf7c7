"""The playback's own JavaScript and style sheet, and uPlot (MIT), which draws its charts."""

from __future__ import annotations

from functools import lru_cache
from importlib.resources import files
from typing import Final

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
    return (files("scenarios.player") / "web" / name).read_text(encoding="utf-8")
