"""Vehicles to test with, each also as a chain of one to four units; engines."""

import pytest

from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.engine.compiler import compiler
from vehicle.engine.kernels import Engine

with_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler here")


def without_air(vehicle: Vehicle) -> Vehicle:
    """Without drag of the air, which closed forms leave out."""
    return vehicle.model_copy(update={"air": None})


def a_double(tractor_semitrailer: Vehicle) -> Vehicle:
    """The tractor, its semi-trailer with a coupling behind, a dolly, and the semi-trailer again."""
    tractor, trailer = tractor_semitrailer.units
    lead = trailer.model_copy(update={"name": "lead", "hitch_x": -11.0, "hitch_height": 0.9})
    dolly = trailer.model_copy(
        update={
            "name": "dolly",
            "mass": 2500.0,
            "yaw_inertia": 2000.0,
            "cg_x": -3.8,
            "cg_height": 0.8,
            "coupling": None,  # a drawbar
            "axles": tuple(
                axle.model_copy(update={"x": x}) for axle, x in zip(trailer.axles, (-3.2, -4.5), strict=False)
            ),
            "hitch_x": -3.7,
            "hitch_height": 1.15,
        }
    )
    return Vehicle(name="a_double", drive=tractor_semitrailer.drive, units=(tractor, lead, dolly, trailer))


def on_gradients(vehicle: Vehicle) -> Vehicle:
    """The vehicle with roll gradients and frequencies of its units in place of suspensions."""
    units = []
    for k, unit in enumerate(vehicle.units):
        axles = tuple(axle.model_copy(update={"suspension": None}) for axle in unit.axles)
        share = 0.0 if unit.coupling is None else 0.33
        gradient, frequency = (0.0071, 1.4) if k == 0 else (0.0089, 1.2)
        given = {"roll_gradient": gradient, "roll_frequency": frequency, "hitch_roll_share": share}
        units.append(unit.model_copy(update={"axles": axles, "roll": None, "coupling": None, **given}))
    return vehicle.model_copy(update={"units": tuple(units)})


@pytest.fixture(params=[pytest.param("compiled", marks=with_compiler), "interpreted"])
def engine(request: pytest.FixtureRequest) -> Engine:
    engine: Engine = request.param
    return engine


@pytest.fixture(scope="session")
def tractor_semitrailer() -> Vehicle:
    return without_air(load_vehicle("eu_tractor_semitrailer"))


@pytest.fixture(scope="session")
def short_form(tractor_semitrailer: Vehicle) -> Vehicle:
    return on_gradients(tractor_semitrailer)


@pytest.fixture(scope="session")
def longer_semitrailer() -> Vehicle:
    return without_air(load_vehicle("uk_longer_semitrailer"))


@pytest.fixture(
    scope="session",
    params=["tractor alone", "tractor and semi-trailer", "steered trailer", "A-double", "roll gradients"],
)
def chain(request: pytest.FixtureRequest, tractor_semitrailer: Vehicle, longer_semitrailer: Vehicle) -> Vehicle:
    return {
        "tractor alone": tractor_semitrailer.model_copy(update={"units": tractor_semitrailer.units[:1]}),
        "tractor and semi-trailer": tractor_semitrailer,
        "steered trailer": longer_semitrailer,
        "A-double": a_double(tractor_semitrailer),
        "roll gradients": on_gradients(tractor_semitrailer),
    }[request.param]
