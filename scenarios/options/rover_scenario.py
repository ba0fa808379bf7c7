"""A rover's scenario: with the seed it determines the run; frozen and validated."""

from typing import ClassVar, Literal

from pydantic import Field

from scenarios.options.base import FullPath, ScenarioTable
from scenarios.options.faults import Faults
from scenarios.options.rover_course import RoverCourseTable
from vehicle.foundation.quantity import Frozen, Parameter, option, quantity

Compensation = Literal["none", "heading", "crab"]


class MoundOptions(Frozen):
    """A round mound, or with a negative height a crater."""

    x: float = quantity(0.0, "m", -1e3, 1e3, "Position of its centre in W.")
    y: float = quantity(0.0, "m", -1e3, 1e3, "Position of its centre in W.")
    radius: float = quantity(1.0, "m", 0.2, 100.0, "Distance from the centre at which the height is 0.14 of the top.")
    height: float = quantity(0.1, "m", -5.0, 5.0, "Height of the top; negative: a crater.")


class RoverSurfaceOptions(Frozen):
    """The ground: slopes, mounds and soil."""

    soil: str = option("Soil by name (see offtrack parts soil) or TOML file; none: hard ground.", "toyoura_sand")
    friction: float = quantity(0.8, "-", 0.05, 1.5, "Friction of hard ground.")
    cross_fall: float = quantity(0.0, "-", -0.6, 0.6, "Cross slope; the ground falls to the right of W's x.")
    grade: float = quantity(0.0, "-", -0.6, 0.6, "Slope along W's x; the ground rises.")
    slope_from: float | None = quantity(
        None, "m", 0.0, 1e3, "Position along W's x where the slopes begin; not given: everywhere."
    )
    slope_over: float = quantity(1.0, "m", 0.1, 100.0, "Distance over which the slopes build up.")
    mounds: tuple[MoundOptions, ...] = option("Mounds and craters, each with x, y, radius and height.", ())
    height_map: FullPath | None = option("File of heights [m], .npy or comma-separated text, rows of growing y.", None)
    height_map_spacing: float = quantity(0.05, "m", 0.001, 10.0, "Grid spacing of the height map.")
    height_map_x: float = quantity(0.0, "m", -1e4, 1e4, "Position of its first column in W.")
    height_map_y: float = quantity(0.0, "m", -1e4, 1e4, "Position of its first row in W.")


class SandOptions(Frozen):
    """Look of the ground, and the light."""

    terrain: str = option("Look of the sand: uniform, ripples, pebbles and others (see docs/rover.md).", "uniform")
    sun_azimuth_deg: float | None = quantity(
        None, "deg", 0.0, 360.0, "Compass direction of the sun; not given: decided by the seed."
    )
    sun_elevation_deg: float | None = quantity(
        None, "deg", 10.0, 90.0, "Elevation of the sun above the horizon; not given: decided by the seed."
    )


class TraceRigOptions(Frozen):
    """The camera behind the left rear wheel, mounted as in the paper (Reina 2008, section II)."""

    rate_hz: float = quantity(5.0, "Hz", 1.0, 20.0, "Frame rate.")
    latency: float = quantity(0.1, "s", 0.0, 2.0, "Time from exposure to the finished estimate.")
    noise: float = quantity(
        2.0, "grey levels", 0.0, 50.0, "Standard deviation of the image noise that is independent of the light."
    )
    shot_noise: float = quantity(
        3.0, "grey levels", 0.0, 50.0, "Standard deviation of the shot noise of a white pixel."
    )


class RoverSignalOptions(Frozen):
    """Encoders, compass and laser tracker."""

    noise: float = quantity(
        1.0, "-", 0.0, 10.0, "Scale of the errors of encoders, compass and laser tracker; 1: data sheets, 0: exact."
    )


class RoverScenario(ScenarioTable):
    """One closed-loop run of a rover."""

    vehicle_kind: ClassVar[str] = "rover"  # key of the tables of kinds

    kind: Literal["rover"] = option("rover: a scenario for rovers.")
    name: str = Field(min_length=1, max_length=100, pattern=r"^[A-Za-z0-9._-]+$", description="Name of the scenario.")
    description: str = option("One line for offtrack scenarios.", "")
    course: RoverCourseTable = option("Path of the rover.")
    vehicle: str = option("Rover by name (see offtrack parts rover) or TOML file.", "el_dorado_ii")
    speed_kmh: float = quantity(0.288, "km/h", 0.05, 1.08, "Set speed of the wheels; 0.288 km/h is 8 cm/s.")
    slip_estimator: str = option(
        "Slip estimator (see offtrack parts slip_estimator) or package.module:Name.", "ftrace_plus"
    )
    estimator: dict[str, Parameter] = Field(
        default_factory=dict, description="Parameters of the slip estimator; those not given keep their defaults."
    )
    sensor: str | None = option(
        "Sensor (see offtrack parts rover_sensor) or package.module:Name; not given: the estimator's own.",
        None,
    )
    sensing: dict[str, Parameter] = Field(default_factory=dict, description="Parameters of the user's own sensor.")
    driver: str = option("Rover driver (see offtrack parts rover_driver) or package.module:Name.", "path")
    driving: dict[str, Parameter] = Field(
        default_factory=dict, description="Parameters of the rover driver; those not given keep their defaults."
    )
    slip_compensation: Compensation = option(
        "Compensation of the estimated slip: none, by the heading, or by pointing the wheels (crab).", "crab"
    )
    navigation: Literal["odometry", "laser"] = option("Source of the position that the rover steers by.", "odometry")
    surface: RoverSurfaceOptions = RoverSurfaceOptions()
    world: SandOptions = SandOptions()
    rig: TraceRigOptions = TraceRigOptions()
    signals: RoverSignalOptions = RoverSignalOptions()
    faults: Faults = option("Faults of the sensor, as text kind:amount@start+duration or as tables.", ())

    @property
    def speed(self) -> float:
        """Set speed of the wheels [m/s]."""
        return self.speed_kmh / 3.6
