"""Brake channels: the wheels that share one brake pressure. They follow from the data of the axles' brakes.

Without ABS an axle, or a group of axles, has one channel. With it, a modulator is a channel: of one wheel, of the
wheels on one side of a group, or of all its wheels.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from vehicle.combination.brake_data import AxleBrake
    from vehicle.combination.description import Vehicle
    from vehicle.combination.unit import Unit


class Channel(NamedTuple):
    """Wheels with a common brake pressure."""

    unit: int
    axles: tuple[int, ...]  # numbers in ``Unit.axles``
    brake: AxleBrake  # of the foremost of them
    side: int  # +1 left, -1 right, 0 both
    valve: int | None  # number of its ABS modulator; None: no ABS
    mirrored: int  # number of the channel that is its mirror image


def brake_channels(vehicle: Vehicle) -> tuple[Channel, ...]:
    """All brake channels, front to rear, left before right; none if the vehicle describes no brakes."""
    channels: list[Channel] = []
    for unit, axles, brake in _groups(vehicle):
        with_abs = vehicle.brakes is not None and vehicle.brakes.abs and brake.abs is not None
        sides = (+1, -1) if with_abs and brake.abs == "wheel" else (0,)
        first = len(channels)
        for k, side in enumerate(sides):
            valve = sum(channel.valve is not None for channel in channels) if with_abs else None
            channels.append(Channel(unit, axles, brake, side, valve, first + len(sides) - 1 - k))
    return tuple(channels)


def channel_of_wheel(vehicle: Vehicle) -> dict[tuple[int, int, int], int]:
    """Number of the brake channel by unit, axle in it, and side (+1 left, -1 right); wheels without brakes lack."""
    return {
        (channel.unit, axle, side): number
        for number, channel in enumerate(brake_channels(vehicle))
        for axle in channel.axles
        for side in (+1, -1)
        if channel.side in (0, side)
    }


def check_brakes(vehicle: Vehicle) -> None:
    """Refuse brakes that do not fit together.

    Raises:
        ValueError: one line that names the table.
    """
    if vehicle.brakes is not None and not any(axle.brake for unit in vehicle.units for axle in unit.axles):
        raise ValueError("brakes: no axle has a brake: give axles a table 'brake', or remove [brakes]")
    for i, axles, brake in _groups(vehicle):
        for k in axles[1:]:
            other = vehicle.units[i].axles[k].brake
            if other is not None and _shared(other) != _shared(brake):
                raise ValueError(
                    f"units.{i}.axles.{k}: brakes of abs_group '{brake.abs_group}' must have the same lag, fill_rate "
                    "and abs"
                )


def _shared(brake: AxleBrake) -> tuple[object, ...]:
    return brake.lag, brake.fill_rate, brake.abs


def _groups(vehicle: Vehicle) -> Iterator[tuple[int, tuple[int, ...], AxleBrake]]:
    """Unit, axles and brake of each group of axles, in the order of their foremost axles."""
    if vehicle.brakes is None:
        return
    for i, unit in enumerate(vehicle.units):
        for axles in _grouped(unit):
            brake = unit.axles[axles[0]].brake
            if brake is not None:
                yield i, axles, brake


def _grouped(unit: Unit) -> list[tuple[int, ...]]:
    groups: dict[str | int, list[int]] = {}
    for k, axle in enumerate(unit.axles):
        if axle.brake is not None:
            groups.setdefault(k if axle.brake.abs_group is None else axle.brake.abs_group, []).append(k)
    return [tuple(group) for group in groups.values()]
