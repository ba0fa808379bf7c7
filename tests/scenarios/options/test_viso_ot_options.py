"""The options of VISO-OT's buffer: where they go, and where they are refused."""

from __future__ import annotations

import pytest

from estimators.off_tracking.viso_ot import VisoOt
from scenarios.assembly.trailer_run import assemble
from scenarios.options.scenario import load_scenario


def test_parameters_have_one_key() -> None:
    """A scenario hands them on as they are; the key of other estimators' parameters names theirs."""
    given = load_scenario("roundabout", ["viso_ot.smoothing=true", "viso_ot.reversing_distance=35"]).viso_ot
    assert given == VisoOt.Parameters(smoothing=True, reversing_distance=35.0)
    with pytest.raises(ValueError, match=r"estimator\.smoothing: the key is viso_ot\.smoothing"):
        load_scenario("roundabout", ["estimator.smoothing=true"])


def test_options_are_refused_where_nothing_would_use_them() -> None:
    """An estimator without this buffer's options says so rather than run without them."""
    for name in ("truth", "kinematic"):
        scenario = load_scenario("roundabout", [f"off_tracking={name}", "viso_ot.smoothing=true"])
        with pytest.raises(ValueError, match=f"apply only to off_tracking = viso_ot, not to {name}"):
            assemble(scenario, 1)
    with pytest.raises(ValueError, match=r"viso_ot.reversing_distance = -1 m must be between 0 and 200 m"):
        load_scenario("roundabout", ["viso_ot.reversing_distance=-1"])


def test_resolved_scenario_runs_again_with_any_estimator() -> None:
    """Its file lists the options with their defaults, which ask for nothing."""
    scenario = load_scenario("roundabout", ["off_tracking=truth"])
    assert "[viso_ot]" in scenario.to_toml()
    assemble(scenario, 1)
