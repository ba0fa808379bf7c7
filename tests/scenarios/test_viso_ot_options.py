"""The options of VISO-OT's buffer: where they go, and where they are refused."""

from __future__ import annotations

import inspect

import pytest

from estimators.off_tracking.viso_ot import VisoOt
from scenarios.assembly.trailer_run import assemble
from scenarios.options.perception import VisoOtOptions
from scenarios.options.scenario import load_scenario


def test_options_are_the_keywords_of_the_estimator_with_the_same_defaults() -> None:
    """The scenario hands them on as they are; a renamed one would only show with cameras."""
    keywords = inspect.signature(VisoOt.__init__).parameters.values()
    defaults = {word.name: word.default for word in keywords if word.kind is word.KEYWORD_ONLY}
    del defaults["path_height"], defaults["towed"], defaults["direction_std"]  # follow from vehicle and calibration
    assert VisoOtOptions().model_dump() == defaults
    told = load_scenario("roundabout", ["viso_ot.smoothing=true", "viso_ot.reversing_distance=35"]).viso_ot
    assert told.model_dump() == {"smoothing": True, "reversing_distance": 35.0, "fusion": "signals"}


def test_options_are_refused_where_nothing_would_use_them() -> None:
    """An estimator without this buffer's options says so rather than run without them."""
    for name in ("truth", "kinematic"):
        scenario = load_scenario("roundabout", [f"off_tracking={name}", "viso_ot.smoothing=true"])
        with pytest.raises(ValueError, match=f"apply only to off_tracking = viso_ot, not to {name}"):
            assemble(scenario, 1)
    with pytest.raises(ValueError, match=r"viso_ot.reversing_distance = -1 must be .* 0 \[m\]"):
        load_scenario("roundabout", ["viso_ot.reversing_distance=-1"])


def test_resolved_scenario_runs_again_with_any_estimator() -> None:
    """Its file lists the options with their defaults, which ask for nothing."""
    scenario = load_scenario("roundabout", ["off_tracking=truth"])
    assert "[viso_ot]" in scenario.to_toml()
    assemble(scenario, 1)
