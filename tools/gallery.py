"""Pictures of the environments for the documents: ``python tools/gallery.py FOLDER``."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from offtrack.environments.registry import single

_SEED: Final = 101
_Entry = Callable[[str], float]  # an entry of the observation by its name


class _Shot(NamedTuple):
    """An environment, and the actions until its picture is taken."""

    file: str
    name: str
    options: dict[str, Any]
    episode: dict[str, Any]  # of the reset
    steps: int
    action: Callable[[_Entry], tuple[float, ...]]


_SHOTS: Final = (
    _Shot(
        "trailer_steering.png",
        "TrailerSteering-v0",
        {"observation": "estimate"},
        {"course": "roundabout", "friction": 0.7, "speed": 5.0, "length": 1.0},
        600,
        lambda observed: (-0.3 * observed("articulation_1"), -0.5 * observed("articulation_1")),
    ),
    _Shot("tractor_trailer_driving.png", "TractorTrailerDriving-v0", {}, {}, 200, lambda observed: (0.1, -0.5)),
    _Shot(
        "rover_steering.png",
        "RoverSteering-v0",
        {"observation": "estimate"},
        {"soil": "toyoura_sand", "cross_fall": 0.09, "curvature": 0.15, "speed": 0.12},
        200,
        lambda observed: (0.5 + 0.3 * _veering(observed), 0.5 - 0.3 * _veering(observed)),
    ),
)


def _veering(observed: _Entry) -> float:
    """Course error of a rover, + left [rad]."""
    return (
        observed("heading_error")
        + observed("slip_angle")
        + 2.0 * observed("cross_track")
        - 0.5 * observed("curvature_ahead")
    )


def main(folder: Path) -> None:
    """Write a PNG of each environment into the folder."""
    for shot in _SHOTS:
        cv2.imwrite(str(folder / shot.file), _taken(shot)[..., ::-1])


def _taken(shot: _Shot) -> NDArray[np.uint8]:
    env = single(shot.name, render_mode="rgb_array", **shot.options)
    names = [feature.name for feature in env.core.features]  # type: ignore[attr-defined]  # every core of the registry lists them
    observed, _ = env.reset(seed=_SEED, options=shot.episode)
    for _ in range(shot.steps):
        values = dict(zip(names, observed.tolist(), strict=True))
        action = np.clip(shot.action(values.__getitem__), -1.0, 1.0)
        observed, *_ = env.step(action.astype(np.float32))
    picture = np.asarray(env.render(), dtype=np.uint8)
    env.close()
    return picture


if __name__ == "__main__":
    if len(sys.argv) != 2 or not Path(sys.argv[1]).is_dir():
        sys.exit("usage: python -m offtrack.environments.gallery FOLDER")
    main(Path(sys.argv[1]))
