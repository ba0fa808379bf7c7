"""Stereo pairs whose exposures are matched, so that no later step compares them again."""

from __future__ import annotations

from dataclasses import dataclass

from sensors.messages import StereoFrame


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MatchedFrame(StereoFrame):
    """A stereo pair with the right image exposed like the left one."""
