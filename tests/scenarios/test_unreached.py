"""Warnings about what a course never meets: at every kind of place, and not where it is met."""

import pytest

from scenarios.loop.runner import KINDS, run
from scenarios.options.scenario import load_any_scenario

DARK = ["off_tracking=truth", "trailer_steering=none", "course.turn_deg=30"]
SLOPE = ["slip_estimator=truth"]
CIRCLE = '[{{kind="circle", x={}, y={}, radius=2.0, friction=0.3}}]'
RECTANGLE = '[{{kind="rectangle", x={}, y=0.0, length=4.0, width=400.0, friction=0.3, heading_deg=90.0}}]'


@pytest.mark.parametrize(
    ("name", "settings", "word"),
    [
        ("roundabout", [*DARK, "wind.speed=5", "wind.start=80"], "wind.start = 80 m"),
        ("roundabout", [*DARK, "wind.speed=5", "wind.start=60"], ""),
        ("roundabout", [*DARK, "wind.speed=5", "wind.start=-60", "wind.length=20"], "wind.start = -60 m"),
        ("roundabout", [*DARK, "wind.speed=0", "wind.start=800"], ""),
        ("roundabout", [*DARK, f"surface.patches={CIRCLE.format(20.0, 2.0)}"], ""),
        ("roundabout", [*DARK, f"surface.patches={CIRCLE.format(20.0, 60.0)}"], "surface.patches.0"),
        ("roundabout", [*DARK, f"surface.patches={RECTANGLE.format(250.0)}"], ""),  # it is turned along the road
        ("roundabout", [*DARK, f"surface.patches={RECTANGLE.format(400.0)}"], "surface.patches.0"),
        ("rover-slope", [*SLOPE], ""),
        ("rover-slope", [*SLOPE, "course.length=3"], "surface.slope_from = 4 m…never met"),
        ("rover-slope", [*SLOPE, "course.length=4.5"], "ends at x = 4.5 m, before the slope is complete at 4.8 m"),
        ("rover-slope", [*SLOPE, "course.length=3", "surface.cross_fall=0"], ""),  # there is no slope at all
        ("rover-slope", [*SLOPE, "surface.mounds=[{x=9.0,y=1.0,radius=0.3}]"], "surface.mounds.0"),
        ("rover-slope", [*SLOPE, "surface.mounds=[{x=3.0,y=1.0,radius=0.3}]"], ""),
    ],
)
def test_a_course_that_never_meets_a_feature_warns(name: str, settings: list[str], word: str) -> None:
    scenario = load_any_scenario(name, settings)
    parts = KINDS[scenario.vehicle_kind].assemble(scenario, 1)
    parts.close()
    lines = "\n".join(parts.remarks)
    assert all(piece in lines for piece in word.split("…")) if word else not lines


def test_a_fault_after_the_end_of_a_run_warns() -> None:
    settings = ["off_tracking=truth", "trailer_steering=none", "course.length=20", "surface.roughness=none"]
    for start, warns in ((0.5, False), (900.0, True)):
        result = run(load_any_scenario("cambered-road", [*settings, f"faults=dropout@{start}+0.1"]), 1)
        assert any("begins at 900 s" in line for line in result.all_warnings()) == warns
