"""Drawings of the manoeuvres that follow a path, for CAD."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from scenarios.assembly.adapters import outlines
from scenarios.drawings.content import DrivenPath, drawing
from scenarios.drawings.files import Format, write_drawing
from scenarios.drawings.of_run import axle_steer, unit_poses
from scenarios.standards.assessment import Assessment
from scenarios.standards.manoeuvre import Manoeuvre


def write_drawings(case: Assessment, folder: Path, before: str, kinds: Sequence[Format]) -> None:
    """Write ``<before><manoeuvre>.<format>`` of every manoeuvre that has a path and moved along it."""
    for manoeuvre in case.manoeuvres:
        if manoeuvre.course is not None and len(manoeuvre.log) > 1:
            drawn = drawing(_driven(case, manoeuvre))
            for kind in kinds:
                write_drawing(drawn, folder / f"{before}{manoeuvre.key}.{kind}", kind)


def _driven(case: Assessment, manoeuvre: Manoeuvre) -> DrivenPath:
    units = outlines(case.vehicle)
    return DrivenPath(
        title=f"{case.vehicle.name}: {manoeuvre.title}",
        notes=(manoeuvre.how, f"load: {case.load}, outcome: {manoeuvre.outcome}"),
        units=units,
        poses=tuple(unit_poses(manoeuvre.log, unit) for unit in units),
        steer=tuple(axle_steer(manoeuvre.log, unit) for unit in units),
        time=manoeuvre.log["time"],
        front_axle_x=case.vehicle.units[0].steered_axles[0].x,
        course=manoeuvre.course,
    )
