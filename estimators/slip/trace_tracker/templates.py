"""Templates of cross profiles of ruts, by slip and sun direction, learned from traces with known truth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from estimators.slip.trace_tracker.ground_patch import STEP
from vehicle.frames import FloatArray

Profiles = NDArray[np.float32]  # (..., CHANNELS, length across)

HALF: Final = round(0.086 / STEP)  # of a template: half the rut, its berm, and the shadow of the wall [px]
WIDTH: Final = 2 * HALF + 1
AZIMUTHS: Final = 12  # of the sun relative to the direction of the trace; the first is straight ahead
ELEVATIONS: Final = np.radians([32.0, 46.0])  # of the sun above the horizon
SLIPS: Final = np.radians(np.linspace(-15.0, 15.0, 13))  # of the front wheel's rut, see ``path_line.with_fronts``
FILE: Final = "templates.npz"
_PARTS: Final = ("profiles", "shaded")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Templates:
    """Mean cross profiles of the rut, each channel with mean 0."""

    profiles: Profiles  # (AZIMUTHS, elevations, slips, CHANNELS, WIDTH) in the sun
    shaded: Profiles  # (slips, CHANNELS, WIDTH) in shade

    def under(self, azimuths: FloatArray) -> Profiles:
        """Profiles (n, elevations, slips, CHANNELS, WIDTH) for the sun at azimuths (n,) relative to the trace [rad]."""
        at = np.mod(azimuths / (2.0 * math.pi) * AZIMUTHS, AZIMUTHS)
        low = np.minimum(at.astype(int), AZIMUTHS - 1)
        share = (at - low).astype(np.float32)[:, None, None, None, None]
        under: Profiles = (1.0 - share) * self.profiles[low] + share * self.profiles[(low + 1) % AZIMUTHS]
        return under


def at_slips(profiles: Profiles, slips: FloatArray) -> Profiles:
    """Interpolate profiles (..., slips, CHANNELS, WIDTH) at slips (n,) [rad]: (..., n, CHANNELS, WIDTH)."""
    at = np.clip(np.interp(slips, SLIPS, np.arange(len(SLIPS))), 0.0, len(SLIPS) - 1.0)
    low = np.minimum(at.astype(int), len(SLIPS) - 2)
    share = (at - low).astype(np.float32)[:, None, None]
    between: Profiles = profiles.take(low, axis=-3)
    between += share * (profiles.take(low + 1, axis=-3) - between)
    return between


def save(templates: Templates, path: Path) -> None:
    """Save templates as bytes with a scale for each, the format of ``shipped_templates``."""
    kept = {}
    for name in _PARTS:
        profiles = getattr(templates, name)
        scale = np.maximum(np.abs(profiles).max(axis=-1), 1e-6) / 127.0
        kept[name] = np.rint(profiles / scale[..., None]).astype(np.int8)
        kept[f"{name}_scale"] = scale.astype(np.float32)
    np.savez_compressed(path, **kept)


def shipped_templates() -> Templates:
    """Templates that are part of this package."""
    with files(__package__).joinpath(FILE).open("rb") as stream, np.load(stream) as kept:
        parts = {name: kept[name].astype(np.float32) * kept[f"{name}_scale"][..., None] for name in _PARTS}
    return Templates(**parts)
