"""Courses of environments by name: those of the scenarios, and random smooth ones."""

from __future__ import annotations

import math

from scenarios.assembly.adapters import course_of
from scenarios.courses import Course, Turn, turns
from scenarios.options.scenario import load_scenario
from scenarios.randomness import stream
from vehicle.combination.description import Vehicle

_RANDOM = "random-"
_TURNS = 5  # 150 m on average: a minute at 10 km/h
_ENTRY = 10.0  # [m]


def named_course(name: str, vehicle: Vehicle) -> Course:
    """Course of a scenario (name or file), or ``random-K``: five smooth turns drawn with seed K.

    Raises:
        ValueError: one line, if there is no such course.
    """
    if not name.startswith(_RANDOM):
        return course_of(load_scenario(name), vehicle)
    number = name.removeprefix(_RANDOM)
    if not number.isdecimal():
        raise ValueError(f"course {name}: must be random-K with an integer K")
    rng, tractor = stream(int(number), "course"), vehicle.units[0]
    sequence = [
        Turn(
            direction="left" if rng.random() < 0.5 else "right",
            radius=float(rng.uniform(11.0, 40.0)),
            angle=math.radians(float(rng.uniform(30.0, 150.0))),
            straight=float(rng.uniform(2.0, 20.0)),
        )
        for _ in range(_TURNS)
    ]
    return turns(front_x=tractor.front_x, width=tractor.width, sequence=sequence, entry=_ENTRY)
