"""Design vehicles of AASHTO in their template turns: minimum inside radius of their trailers."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from controllers.path import Path, arc, line
from scenarios.assembly.adapters import outlines
from scenarios.results.swept_path import placed
from scenarios.validation.check import Check, Plot, Section, Series
from scenarios.validation.driving import along_path, poses_of
from scenarios.validation.no_slip import poses_along, rolling_chain
from scenarios.validation.vehicles import tractor_and_trailer
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.frames import FloatArray, Pose2

_FOOT: Final = 0.3048  # [m]
_HALF_WIDTH: Final = 4.25 * _FOOT  # of every design vehicle's trailer, 8.5 ft [m]
_SPEED: Final = 0.5  # [m/s]; slip moves the trailer's path outwards by 4 mm, and by four times that at 1 m/s
_ENTRY, _EXIT = 4.0, 20.0  # [m]; the trailer is closest when the tractor has left the turn by up to a trailer length


class _Design(NamedTuple):
    name: str
    vehicle: Vehicle
    radius: float  # of the front axle's centre: centreline turning radius [ft]
    inside: float  # published [ft]
    tolerance: float  # [ft]
    source: str


def design_vehicles(quick: bool) -> Section:
    """Turns of 180 degrees on the template's centreline radius, with the whole dynamic model at walking pace."""
    turns = [(design, *_turned(design)) for design in _designs()[: 2 if quick else 3]]
    checks = tuple(
        Check(
            f"{design.name}: minimum inside radius, 180° turn on {design.radius:g} ft",
            float(_radii(design, centre, poses).min()) / _FOOT,
            "ft",
            target=design.inside,
            tolerance=design.tolerance,
            source=design.source,
        )
        for design, centre, poses in turns
    )
    return Section(
        title="Design vehicles",
        text="The dynamic model drives each vehicle's template turn at walking pace, the centre of its front axle on "
        "the centreline radius. Result: smallest distance of the inner end of the trailer's axle from the centre.",
        checks=checks,
        plots=tuple(_plan(design, centre, poses) for design, centre, poses in turns[:1]),
    )


def _designs() -> list[_Design]:
    wb62, table = load_vehicle("wb62"), "AASHTO Green Book table, as printed by sddc.army.mil"
    wb40 = tractor_and_trailer(wb62, wheelbase=12.5 * _FOOT, hitch_x=0.0, length=25.5 * _FOOT)
    return [
        _Design("WB-62", wb62, 41.0, 7.4, 0.1, table),
        _Design("WB-67", load_vehicle("wb67"), 41.0, 1.9, 0.1, "AASHTO Green Book 2011, from memory"),
        _Design(
            "WB-40",
            wb40,
            36.4,
            19.3,
            0.4,
            "AASHTO Green Book table, as printed by sddc.army.mil, with lengths from memory",
        ),
    ]


def _turned(design: _Design) -> tuple[Pose2, FloatArray]:
    """Centre of the turn, and the poses of both units during it."""
    path, front = _template(design)
    return path.start @ Pose2(_ENTRY, design.radius * _FOOT, 0.0), poses_of(
        along_path(design.vehicle, path, (front, 0.0), _SPEED)
    )


def _template(design: _Design) -> tuple[Path, float]:
    """Path of the front axle's centre, and its position in T [m]."""
    radius, front = design.radius * _FOOT, design.vehicle.units[0].steered_axles[0].x
    return Path(Pose2(front, 0.0, 0.0), (line(_ENTRY), arc(math.pi * radius, 1.0 / radius), line(_EXIT))), front


def _inner_end(design: _Design, poses: FloatArray) -> FloatArray:
    """Path of the inner end of the trailer's axle, (n, 2)."""
    axle = design.vehicle.units[1].axles[0].x
    return placed(np.array([[axle, _HALF_WIDTH]]), poses[:, 1])[:, 0]


def _radii(design: _Design, centre: Pose2, poses: FloatArray) -> FloatArray:
    """Distance of this end from the centre of the turn, (n,) [m]."""
    path = _inner_end(design, poses)
    return np.hypot(path[:, 0] - centre.x, path[:, 1] - centre.y)


def _bodies(design: _Design, poses: FloatArray) -> list[FloatArray]:
    """Closed outlines (5, 2) of the units at poses (N, 3)."""
    bodies = zip(outlines(design.vehicle), poses, strict=True)
    return [placed(body.corners[[0, 1, 2, 3, 0]], pose[None])[0] for body, pose in bodies]


def _plan(design: _Design, centre: Pose2, poses: FloatArray) -> Plot:
    path, front = _template(design)
    rolled = poses_along(rolling_chain(design.vehicle), path, (front, 0.0))
    around = np.linspace(0.0, 2.0 * math.pi, 100)
    published = design.inside * _FOOT * np.column_stack([np.cos(around), np.sin(around)]) + centre[:2]
    closest = int(np.argmin(_radii(design, centre, poses)))
    front_axle = placed(np.array([[front, 0.0]]), poses[:, 0])[:, 0]
    return Plot(
        title=f"{design.name}: 180° turn from above, and the combination where its axle is closest",
        x_label="x [m]",
        y_label="y [m]",
        series=(
            *(Series("", *_xy(body), "faint") for body in _bodies(design, poses[closest])),
            Series("centre of the front axle", *_xy(front_axle), "faint"),
            Series("inner end of the trailer's axle", *_xy(_inner_end(design, poses)), "model"),
            Series("the same without slip", *_xy(_inner_end(design, rolled)[::50]), "reference points"),
            Series("published inside radius", *_xy(published), "reference"),
        ),
        to_scale=True,
    )


def _xy(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    return points[:, 0], points[:, 1]
