"""What is measured in the standard manoeuvres, in people's words and units."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantity:
    """A measured quantity as people are shown it."""

    name: str  # in figures and in JSON, with its unit
    label: str
    unit: str  # shown
    meaning: str
    factor: float = 1.0  # from SI to the unit shown
    digits: int = 2

    def text(self, value: float) -> str:
        """A value with its unit; a dash where there is none."""
        if not math.isfinite(value):
            return "–"
        unit = self.unit if self.unit in ("", "°") else f" {self.unit}"
        return f"{self.factor * value:.{self.digits}f}{unit}"


QUANTITIES: Final = (
    Quantity(
        name="swept_path_m",
        label="Swept path",
        unit="m",
        meaning="The widest strip that the bodies sweep, square to the path of the tyre.",
    ),
    Quantity(
        name="frontal_swing_m",
        label="Frontal swing",
        unit="m",
        meaning="How far the tractor's front corner swings out beyond the path of the tyre.",
    ),
    Quantity(
        name="frontal_swing_mod_m",
        label="Frontal swing, trailer beyond tractor",
        unit="m",
        meaning="Maximum of difference: how far a trailer's front corner swings out beyond the tractor's, anywhere.",
    ),
    Quantity(
        name="frontal_swing_dom_m",
        label="Frontal swing, trailer's less tractor's",
        unit="m",
        meaning="Difference of maxima: the largest swing of a trailer's front corner less that of the tractor's.",
    ),
    Quantity(
        name="tail_swing_entry_m",
        label="Tail swing at entry",
        unit="m",
        meaning="How far a rear corner swings out beyond the straight before the turn.",
        digits=3,
    ),
    Quantity(
        name="tail_swing_exit_m",
        label="Tail swing at exit",
        unit="m",
        meaning="How far a rear corner swings out beyond the straight behind the turn.",
        digits=3,
    ),
    Quantity(
        name="steer_friction_demand",
        label="Friction demand of the steer tyres",
        unit="%",
        meaning="Horizontal force of the first steered axle's tyres over what friction allows them.",
        factor=100.0,
        digits=0,
    ),
    Quantity(
        name="turn_path_error_m",
        label="Driver's path error, turn",
        unit="mm",
        meaning="How far the tyre was off its path at most; the standard allows 50 mm.",
        factor=1e3,
        digits=1,
    ),
    Quantity(
        name="roundabout_inner_radius_m",
        label="Inner radius",
        unit="m",
        meaning="The closest any body comes to the centre.",
    ),
    Quantity(
        name="roundabout_outer_radius_m",
        label="Outer radius",
        unit="m",
        meaning="The farthest any body reaches from it: 12.50 m, where the driver puts the front corner.",
    ),
    Quantity(
        name="roundabout_width_m",
        label="Swept annulus",
        unit="m",
        meaning="The outer less the inner radius.",
    ),
    Quantity(
        name="roundabout_tail_swing_m",
        label="Tail swing, roundabout",
        unit="m",
        meaning="How far a rear corner swings out beyond the straights, at entry or exit.",
        digits=3,
    ),
    Quantity(
        name="roundabout_articulation_rad",
        label="Largest articulation",
        unit="°",
        meaning="The largest angle between two units.",
        factor=180.0 / math.pi,
        digits=1,
    ),
    Quantity(
        name="roundabout_path_error_m",
        label="Driver's path error, roundabout",
        unit="mm",
        meaning="How far the front corner was off its path at most.",
        factor=1e3,
        digits=1,
    ),
    Quantity(
        name="rearward_amplification",
        label="Rearward amplification",
        unit="",
        meaning="Largest lateral acceleration of the last unit's centre of gravity over the front axle's.",
    ),
    Quantity(
        name="rearward_amplification_yaw",
        label="Rearward amplification of yaw rate",
        unit="",
        meaning="Largest yaw rate of the last unit over the tractor's.",
    ),
    Quantity(
        name="transient_off_tracking_m",
        label="Transient off-tracking",
        unit="m",
        meaning="How far the last axle runs outside the path of the front axle.",
        digits=3,
    ),
    Quantity(
        name="front_peak_acceleration_m_s2",
        label="Front axle's peak acceleration",
        unit="m/s²",
        meaning="What the steering robot achieved; the standard asks for 0.15 g, 1.472 m/s².",
        digits=3,
    ),
    Quantity(
        name="front_path_error_m",
        label="Front axle's path error",
        unit="mm",
        meaning="How far the front axle was off the prescribed path at most.",
        factor=1e3,
        digits=1,
    ),
    Quantity(
        name="lane_change_load_transfer",
        label="Largest load transfer, lane change",
        unit="",
        meaning="Right less left wheel loads of a unit over their sum; at 1 it stands on one side.",
    ),
    Quantity(
        name="tracking_width_m",
        label="Swept width",
        unit="m",
        meaning="The widest strip that the bodies sweep once the combination has settled.",
    ),
    Quantity(
        name="tracking_offset_m",
        label="Off-tracking",
        unit="m",
        meaning="How far the last axle runs beside the front axle at most.",
        digits=3,
    ),
    Quantity(
        name="tracking_path_error_m",
        label="Driver's path error, straight",
        unit="mm",
        meaning="How far the front axle was beside its line at most.",
        factor=1e3,
        digits=1,
    ),
    Quantity(
        name="yaw_damping",
        label="Yaw damping",
        unit="",
        meaning="Damping ratio of the least damped yaw rate or articulation after the pulse.",
    ),
    Quantity(
        name="pulse_load_transfer",
        label="Largest load transfer, pulse",
        unit="",
        meaning="Right less left wheel loads of a unit over their sum.",
    ),
    Quantity(
        name="rollover_threshold_g",
        label="Static rollover threshold",
        unit="g",
        meaning="Slope, and so lateral acceleration in g, at which one side of a unit carries nothing.",
        digits=3,
    ),
    Quantity(
        name="rollover_acceleration_m_s2",
        label="Rollover threshold as acceleration",
        unit="m/s²",
        meaning="The threshold times the acceleration of gravity.",
    ),
    Quantity(
        name="wheel_lift_g",
        label="First wheel lifts at",
        unit="g",
        meaning="Slope at which the first wheel of all carries nothing.",
        digits=3,
    ),
    Quantity(
        name="wheel_lift_roll_rad",
        label="Body roll then",
        unit="°",
        meaning="The largest roll of a body on its suspension when the first wheel lifts.",
        factor=180.0 / math.pi,
        digits=1,
    ),
)
BY_NAME: Final = {quantity.name: quantity for quantity in QUANTITIES}
