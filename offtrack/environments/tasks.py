"""Tasks of the benchmark: environments by plain values, what counts as success, and the seeds of the evaluation.

A new task is a line in ``TASKS``.
"""

from collections.abc import Mapping
from typing import Any, Final, Literal, NamedTuple

from vehicle.foundation.user_file import nearest

FIRST_SEED: Final = 900_000_000  # of the evaluation; training seeds lie far below
EPISODES: Final = 100  # of an evaluation
LAWS: Final = ("none", "command_steer", "ct_at", "path_preview", "virtual_driver", "lqr", "mpc", "policy")

Role = Literal["trailer", "driver", "rover"]


class Task(NamedTuple):
    """A task of the benchmark. An episode succeeds if it is completed, with at most the largest error."""

    words: str  # what is to be done
    role: Role
    environment: str
    options: Mapping[str, Any]  # of the evaluation
    training: Mapping[str, Any] = {}  # options of the training that differ
    most: tuple[str, float] | None = None  # name in the info, and largest value at the end of a success
    error: str = "true_max_m"  # name in the info of the error in the table [m]
    drivers: tuple[str, ...] = LAWS  # baselines: steering laws, or drivers of ``training.pilots``
    observation: str | None = "surrogate"  # by default; None: the environment has no choice
    exploration: tuple[float, float] = (0.3, 0.05)  # of a training: standard deviation of actions, start and end
    discount: float = 0.985  # of a training, per action of 80 ms: a horizon of 5 s, for an end to reach

    def environment_options(
        self, observation: str | None = None, vehicle: str | None = None, *, training: bool = False
    ) -> dict[str, Any]:
        """Options of the environment, with another observation or vehicle than the usual one."""
        source = None if self.observation is None else observation or self.observation
        chosen = {"observation": source, "vehicle": vehicle}
        given = {name: value for name, value in chosen.items() if value is not None}
        return {**self.options, **(self.training if training else {}), **given}


def task_of(name: str) -> Task:
    """The task of this name.

    Raises:
        ValueError: one line, if there is none.
    """
    if name not in TASKS:
        raise ValueError(f"unknown task '{name:.80}'{nearest(name, TASKS)}")
    return TASKS[name]


def _bends(*sizes: tuple[float, float], before: float = 60.0, after: float = 60.0) -> list[dict[str, Any]]:
    """Bends of these radii [m] and angles [deg] to both sides; the middle of the tractor's front is guided."""
    return [
        {
            "kind": "segments",
            "entry": before,
            "turns": [{"direction": direction, "radius": radius, "turn_deg": angle, "straight": after}],
        }
        for radius, angle in sizes
        for direction in ("left", "right")
    ]


def _corners(*radii: float) -> list[dict[str, Any]]:
    return _bends(*((radius, 90.0) for radius in radii), before=20.0, after=30.0)


def _loop(radius: float, side: tuple[str, str]) -> dict[str, Any]:
    """Turning loop of a yard: aside, round and out by the gate by which one came in."""
    aside = {"direction": side[1], "radius": 16.0, "turn_deg": 50.0, "straight": 1.0}
    around = {"direction": side[0], "radius": radius, "turn_deg": 280.0, "straight": 1.0}
    return {"kind": "segments", "entry": 20.0, "turns": [aside, around, {**aside, "straight": 25.0}]}


def _loops(radii: tuple[float, ...]) -> list[dict[str, Any]]:
    return [_loop(radius, side) for radius in radii for side in (("left", "right"), ("right", "left"))]


_SMOOTH: Final = ("figure-of-eight", "farm-track", *(f"random-{k}" for k in range(101, 109)))
_LEARNT: Final = ("roundabout", "roundabout-right", "turn-90", *(f"random-{k}" for k in range(1, 17)))
_LARGE: Final = _bends((40.0, 90.0), (80.0, 60.0), (200.0, 40.0), (400.0, 30.0))
_ANY_SPEED: Final = {"speed": (1.4, 25.0), "actuator_lag": (0.1, 3.3)}  # the lag of the file is 0.15 s
_ROADS: Final = {"friction": (0.3, 0.9), "length": 1.0}
_UNSEEN: Final = [f"roundabout-{k}" for k in range(1001, 1101)]
_SEEN: Final = {"courses": [f"roundabout-{k}" for k in range(1, 129)]}
_SLIPPERY: Final = {"friction": (0.12, 0.3), "length": 1.0}

TASKS: Final[Mapping[str, Task]] = {
    "paths": Task(
        "Steer a 14 m semitrailer on unseen smooth paths at 5 to 20 km/h, within 0.5 m of its hitch's path.",
        "trailer",
        "TrailerSteering-v0",
        {"courses": _SMOOTH, "domain": {}},
        {"courses": _LEARNT, "domain": {"friction": (0.3, 0.9), "speed": (1.4, 5.0)}},
        most=("true_max_m", 0.5),
        discount=0.96,
    ),
    "any-speed": Task(
        "The same at 5 to 90 km/h on bends of 11 to 400 m and in a change of lane, lags of the axles up to 0.5 s.",
        "trailer",
        "TrailerSteering-v0",
        {"courses": ["lane-change", *_SMOOTH, *_LARGE], "domain": _ANY_SPEED},
        {"courses": [*_LEARNT, *_bends((60.0, 75.0), (120.0, 50.0), (300.0, 35.0))]},
        most=("true_max_m", 0.5),
        discount=0.96,
    ),
    "roundabouts": Task(
        "Steer a 14 m semitrailer round unseen roundabouts of 12.5 to 20 m, within the edges of a road of 7 m.",
        "trailer",
        "TrailerSteering-v0",
        {"courses": _UNSEEN, "road_width": 7.0, "domain": _ROADS},
        _SEEN,
    ),
    "roundabouts-driver": Task(
        "Drive a tractor-semitrailer round the same roundabouts, within the edges of a road of 7.7 m.",
        "driver",
        "TractorTrailerDriving-v0",
        {"task": "road", "courses": _UNSEEN, "road_width": 7.7, "domain": _ROADS},
        _SEEN,
        drivers=("on_road",),
        observation=None,
        exploration=(0.3, 0.12),  # down to 0.05 it learns to brush the edges
    ),
    "gate": Task(
        "Drive a tractor-semitrailer through a gate 40 to 70 m ahead: its end within 0.3 m and 5 deg.",
        "driver",
        "TractorTrailerDriving-v0",
        {"task": "gate"},
        error="distance_m",
        drivers=("through_gate",),
        observation=None,
    ),
    "bay": Task(
        "Reverse a tractor-semitrailer into a bay 10 to 25 m behind: its end within 0.3 m and 5 deg, standing.",
        "driver",
        "TractorTrailerDriving-v0",
        {"task": "bay"},
        error="distance_m",
        drivers=("into_bay",),
        observation=None,
    ),
    "depot": Task(
        "Steer a 14 m semitrailer round the turning loop of a yard, 280 deg at 14 to 16 m, on a lane of 9 m.",
        "trailer",
        "TrailerSteering-v0",
        {"courses": _loops((14.0, 15.0, 16.0)), "road_width": 9.0, "domain": {**_ROADS, "speed": (1.4, 2.8)}},
        {"courses": _loops((14.5, 15.5))},
    ),
    "slippery-turn": Task(
        "Steer a 14 m semitrailer round a street corner of 14 to 18 m on ice and snow, on a road of 8 m.",
        "trailer",
        "TrailerSteering-v0",
        {"courses": _corners(14.0, 16.0, 18.0), "road_width": 8.0, "domain": _SLIPPERY},
        {"courses": _corners(15.0, 17.0)},
    ),
    "rover-slope": Task(
        "Keep a skid-steered rover within 0.15 m of its path on sand, across slopes of up to 12 %.",
        "rover",
        "RoverSteering-v0",
        {"domain": {"cross_fall": (-0.12, 0.12)}},
        most=("cross_track_max_m", 0.15),
        error="cross_track_max_m",
        drivers=("on_slope", "ignoring_slip"),
    ),
}
