"""Types of numbers with unit and limits, for the models of the parameter files.

The limits of a combination's numbers refuse what no vehicle on a road can have: mistakes of unit, sign and decimal
point. Each has its reason, which the error message shows. Numbers that are possible but contradict one another are
warned of in ``vehicle.combination.plausibility``.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field


def quantity(
    unit: str,
    *,
    ge: float | None = None,
    gt: float | None = None,
    le: float,
    meaning: str | None = None,
    why: str | None = None,
) -> Any:
    """Pydantic field of a number: its limits, the unit that error messages name, its meaning, reason of the limits."""
    extra: dict[str, Any] = {"unit": unit} | ({} if why is None else {"why": why})
    return Field(ge=ge, gt=gt, le=le, strict=True, allow_inf_nan=False, json_schema_extra=extra, description=meaning)


Mass = Annotated[
    float,
    quantity("kg", ge=100.0, le=2e5, why="a unit weighs 100 kg, a car's trailer, to 200 t, a heavy-haulage module"),
]
Inertia = Annotated[
    float,
    quantity("kg m2", ge=10.0, le=1e7, why="10 is 100 kg with a radius of gyration of 0.3 m, 1e7 is 200 t with 7 m"),
]
Position = Annotated[
    float, quantity("m", ge=-40.0, le=40.0, why="no unit is longer than 40 m; positions are in its own frame")
]
Length = Annotated[float, quantity("m", gt=0.0, le=10.0, why="a length in m, below that of a unit")]
Breadth = Annotated[
    float, quantity("m", ge=0.5, le=8.0, why="road vehicles are 0.5 m to 2.6 m wide, abnormal loads up to 8 m")
]
Height = Annotated[
    float, quantity("m", ge=0.1, le=8.0, why="road vehicles are up to 4.6 m high, abnormal loads up to 8 m")
]
Fraction = Annotated[float, quantity("-", ge=0.0, le=1.0, why="a share is from 0 to 1, not per cent")]
Flag = Annotated[bool, Field(strict=True)]
Lag = Annotated[
    float, quantity("s", gt=0.0, le=5.0, why="a lag is above 0 s; with one of more than 5 s nothing is controlled")
]
Gradient = Annotated[
    float,
    quantity(
        "rad/(m/s2)",
        ge=1e-5,
        le=0.05,
        why="a body tilts by at least 0.006 deg/g, rigid axles on solid tyres, and at 28 deg/g it falls over",
    ),
]
Frequency = Annotated[
    float,
    quantity(
        "Hz",
        ge=0.2,
        le=5.0,
        why="springs of 0.2 Hz give way by 6 m under the weight; 5 Hz is stiffer than tyres without springs, and too "
        "stiff for a step of 1 ms",
    ),
]


class Frozen(BaseModel):
    """Immutable, validated model that accepts no unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid")
