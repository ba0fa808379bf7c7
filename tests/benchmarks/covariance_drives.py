"""Short recorded drives for `tests.benchmarks.covariance`: development on some roads and seeds, the check on others."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

from offtrack.exchange.recordings.writers import recording_in
from scenarios.loop.runner import run
from scenarios.options.scenario import Scenario, load_any_scenario

_ALL: Final = ("off_tracking=surrogate", "reference_unit=false")  # the recorded images are what counts
_FIELD: Final = (  # a rough road, and cameras with all their faults
    *("surface.roughness=C", "surface.potholes=3", "rig.noise=3", "rig.shot_noise=2", "rig.exposure=auto"),
    *("rig.exposure_time_ms=4", "rig.vignetting=0.3", "rig.glare=0.2", "rig.calibration=boards"),
    *("rig.distortion=[-0.12, 0.01, 0.0005, -0.0005, 0.0]", "rig.misrotation_deg=[-0.15, 0.1, 0.0]"),
    *("rig.twist_deg=[0.05, 0.03, 0.05]", "rig.self_calibration=true"),
)
_ROUND: Final = ("course.entry=20", "course.turn_deg=75", "course.exit=5")
_TURN: Final = ("course.entry=20", "course.turn_deg=90", "course.exit=10", "speed_kmh=10")
_MINI: Final = ("course.begin=30", "course.length=42")
_FAST: Final = ("speed_kmh=40", "course.length=110")


class Drive(NamedTuple):
    """A drive that is recorded: a scenario with settings and a seed."""

    scenario: str
    seed: int
    settings: tuple[str, ...]

    @property
    def self_calibrating(self) -> bool:
        """True if the run estimates the rotation of the right camera; else it is only watched."""
        return self.resolved().rig.self_calibration

    def resolved(self) -> Scenario:
        """The scenario with its settings."""
        scenario = load_any_scenario(self.scenario, (*_ALL, *self.settings))
        if not isinstance(scenario, Scenario):
            raise TypeError(f"{self.scenario}: no scenario of a trailer")
        return scenario


DEVELOPMENT: Final = {
    "clean": Drive("roundabout", 1, _ROUND),
    "clean, to the right": Drive("roundabout", 2, (*_ROUND, "course.direction=right")),
    "field": Drive("roundabout", 3, (*_ROUND, *_FIELD)),
    "field, slip": Drive("constant-slip", 4, ("course.length=60", *_FIELD)),
    "bank 2.5 %": Drive("roundabout", 5, (*_ROUND, "surface.cross_fall=0.025")),
    "bank -5 %": Drive("roundabout", 6, (*_ROUND, "surface.cross_fall=-0.05")),
    "friction 0.3": Drive("roundabout", 7, (*_ROUND, "surface.friction=0.3", "surface.cross_fall=0.025")),
    "class D": Drive("roundabout", 8, (*_ROUND, "surface.roughness=D")),
    "class E": Drive("roundabout", 9, (*_ROUND, "surface.roughness=E")),
    "fast": Drive("constant-slip", 10, _FAST),
    "bare ground": Drive("roundabout", 11, (*_ROUND, "world.scenery_density=0")),
}
CHECK: Final = {
    "clean": Drive("turn-90", 21, _TURN),
    "clean, mini": Drive("mini-roundabout", 22, _MINI),
    "field": Drive("turn-90", 23, (*_TURN, *_FIELD)),
    "field, mini": Drive("mini-roundabout", 24, (*_MINI, *_FIELD)),
    "bank 5 %": Drive("turn-90", 25, (*_TURN, "course.direction=right", "surface.cross_fall=0.05")),
    "bank -2.5 %": Drive("mini-roundabout", 26, (*_MINI, "surface.cross_fall=-0.025")),
    "friction 0.3": Drive("turn-90", 27, (*_TURN, "surface.friction=0.3", "surface.cross_fall=0.025")),
    "class D": Drive("mini-roundabout", 28, (*_MINI, "surface.roughness=D")),
    "class E": Drive("turn-90", 29, (*_TURN, "surface.roughness=E")),
    "fast": Drive("constant-slip", 30, (*_FAST, "course.slip_angle_deg=-8")),
    "bare ground": Drive("turn-90", 31, (*_TURN, "world.scenery_density=0", "world.overcast=true")),
    "lane change, C": Drive(
        "lane-change", 32, ("speed_kmh=60", "course.entry=40", "course.exit=60", "surface.roughness=C")
    ),
}
SETS: Final = {"development": DEVELOPMENT, "check": CHECK}


def recorded(folder: Path, drives: dict[str, Drive]) -> Iterator[tuple[str, Drive, Path]]:
    """Each drive with its name and the folder of its images; those that are not there yet are rendered."""
    for name, drive in drives.items():
        place = folder / f"{drive.scenario}-{drive.seed}"
        if not place.exists():
            run(drive.resolved(), drive.seed, record=recording_in(place))
        yield name, drive, place
