"""Pictures for the documents: ``python tools/gallery.py FOLDER [RUN ...]``.

Without a run they are those of the environments; of each run's video a short animation, named as the run's directory.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

import av
import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from offtrack.environments.registry import single

_SEED: Final = 101
_WIDTH: Final = 640  # of an animation [px]
_PICTURES: Final = 36  # in it, evenly over the run
_SHOWN: Final = 200  # each [ms]
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
        "trailer_steering.jpg",
        "TrailerSteering-v0",
        {"observation": "estimate"},
        {"course": "roundabout", "friction": 0.7, "speed": 5.0, "length": 1.0},
        600,
        lambda observed: (-0.3 * observed("articulation_1"), -0.5 * observed("articulation_1")),
    ),
    _Shot("tractor_trailer_driving.png", "TractorTrailerDriving-v0", {}, {}, 200, lambda observed: (0.1, -0.5)),
    _Shot(
        "rover_steering.jpg",
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


def main(folder: Path, runs: list[Path]) -> None:
    """Write a picture of each environment, or an animation of each run, into the folder."""
    for run in runs:
        first, *others = _pictures(run / "video.mp4")
        file = folder / f"{run.resolve().name}.webp"
        first.save(file, save_all=True, append_images=others, duration=_SHOWN, loop=0, quality=55)
    for shot in _SHOTS if not runs else ():
        cv2.imwrite(str(folder / shot.file), _taken(shot)[..., ::-1])


def _pictures(video: Path) -> list[Image.Image]:
    """Pictures of a video, evenly over its duration."""
    with av.open(str(video)) as container:
        frames = [frame.to_image() for frame in container.decode(video=0)]
    size = (_WIDTH, round(frames[0].height * _WIDTH / frames[0].width))
    chosen = np.linspace(0, len(frames) - 1, _PICTURES).round().astype(int)
    return [frames[k].resize(size, Image.Resampling.LANCZOS) for k in chosen]


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
    if len(sys.argv) < 2 or not Path(sys.argv[1]).is_dir():
        sys.exit("usage: python tools/gallery.py FOLDER [RUN ...]")
    main(Path(sys.argv[1]), [Path(run) for run in sys.argv[2:]])
