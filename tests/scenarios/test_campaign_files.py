"""Campaign files: which runs they ask for, that they survive writing and reading, and how they are refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from offtrack.studies.campaigns.campaign import Campaign, campaign_names, campaign_path, load_campaign, with_changes
from offtrack.studies.campaigns.fault_entry import FaultTime, fault_time
from offtrack.studies.campaigns.verdict import time_of

HEAD = """scenario = "roundabout"
seeds = [1, 2]
[set]
off_tracking = "surrogate"
[vary]
trailer_steering = ["path_preview", "mpc"]
surface.friction = [0.8, 0.3]
[requirements]
off_tracking.true_max_m = 0.5
steer.max_deg = { min = -1, max = 40 }
time_to_detect_s = 1
outcomes = ["completed", "timed out"]
"""
BIAS = '[[fault]]\nkind = "gyro_bias"\namounts = [1, 5]\nonsets = [6, 8]\ndurations = [2, "end"]\n'
BISECT = '[[bisect]]\nfault = "{}"\nlow = {}\nhigh = {}\ntolerance = 0.1\n'
DRAWN = """[[fault]]
kind = "dropout"
amounts.uniform = [0.2, 1]
onsets.uniform = [4, 7]
durations = [2]
[sample]
count = 8
"""


def campaign(tmp_path: Path, text: str) -> Campaign:
    path = tmp_path / "campaign.toml"
    path.write_text(text, encoding="utf-8")
    return load_campaign(path)


def test_lists_are_combined_and_the_reference_runs_once_for_each_law_and_seed(tmp_path: Path) -> None:
    """Two amounts, two onsets, two durations; two laws, two frictions, two seeds; and runs without a fault."""
    read = campaign(tmp_path, HEAD + BIAS)
    cases = read.cases()
    assert len(cases) == 8 * 8 + 8
    faults = [dict(case.axes)["faults"] for case in cases]
    assert faults.count("none") == 8
    assert set(faults) - {"none"} == {
        f"gyro_bias:{amount}@{onset}{duration}" for amount in "15" for onset in "68" for duration in ("+2", "")
    }
    assert (read.law, read.further) == ("trailer_steering", ("surface.friction",))
    assert campaign(tmp_path, read.to_toml()) == read


def test_an_entry_runs_with_its_seeds_and_values_alone_and_so_does_its_reference(tmp_path: Path) -> None:
    """``only`` and ``seeds`` take runs out; the reference of those goes with them."""
    only = 'only = { trailer_steering = "mpc", surface.friction = [0.3] }\nseeds = [2]\n'
    read = campaign(tmp_path, HEAD + BIAS + only)
    cases = read.cases()
    assert len(cases) == 8 + 1
    assert {(case.seed, *(value for _, value in case.axes[1:])) for case in cases} == {(2, "mpc", "0.3")}
    assert campaign(tmp_path, read.to_toml()) == read


def test_drawn_numbers_are_words_of_the_fault_and_the_reference_is_not_repeated(tmp_path: Path) -> None:
    """Each draw has an onset of whole milliseconds; runs without a fault are as many as there are seeds."""
    read = campaign(tmp_path, HEAD + DRAWN)
    cases = read.cases()
    references = [case for case in cases if dict(case.axes)["faults"] == "none"]
    assert (len(cases), len(references)) == (4 * 8 + 4 * 2, 4 * 2)
    (first, *_) = (case for case in cases if case not in references)
    fault = first.settings[-3]
    assert fault.startswith("faults=dropout:0.")
    time = time_of(first)
    assert time is not None
    assert time.end is not None
    assert time.onset == round(time.onset, 3)
    assert time.end == pytest.approx(time.onset + 2.0)
    assert len({time_of(case) for case in cases if case not in references}) == 8
    first.resolved()
    assert campaign(tmp_path, read.to_toml()).cases() == cases


def test_the_time_of_several_faults_is_from_the_first_onset_to_the_last_end() -> None:
    assert fault_time("dropout@3+1; gyro_bias:2@5+4") == FaultTime(3.0, 9.0)
    assert fault_time("dropout@3; gyro_bias:2@5+4") == FaultTime(3.0, None)
    assert fault_time("none") is None


def test_settings_and_seeds_of_the_command_replace_those_of_the_file(tmp_path: Path) -> None:
    """A key that the file varies is not varied any more."""
    read = campaign(tmp_path, HEAD + BIAS + "seeds = [2]\n")
    changed = with_changes(read, (("surface.friction", "0.5"),), (7,))
    assert {case.seed for case in changed.cases()} == {7}
    assert len(changed.cases()) == 2 * 9
    assert "surface.friction=0.5" in changed.cases()[0].settings
    only = campaign(tmp_path, HEAD + BIAS + "only.surface.friction = 0.3\n")
    assert len(with_changes(only, (("surface.friction", "0.3"),), None).cases()) == 2 * 2 * 9
    assert not with_changes(only, (("surface.friction", "0.8"),), None).cases()


def test_the_shipped_campaign_compares_three_laws_with_and_without_cameras() -> None:
    """More than 300 runs by the surrogate and 60 with cameras, besides the references."""
    assert "trailer-steering-faults" in campaign_names()
    path = campaign_path("trailer-steering-faults")
    assert path is not None
    read = load_campaign(path)
    faulty = [dict(case.axes) for case in read.cases() if read.entry_of(case)]
    sources = [axes["off_tracking"] for axes in faulty]
    assert sources.count("surrogate") >= 300
    assert sources.count("viso_ot") >= 60
    assert {axes["trailer_steering"] for axes in faulty} == {"path_preview", "mpc", "virtual_driver"}
    assert {axes["surface.friction"] for axes in faulty} == {"0.8", "0.3"}


def test_the_shipped_campaign_of_a_rover_has_the_faults_of_its_camera() -> None:
    """Frozen, black, missing and repeated images, and images through dirt and glare, with both compensations."""
    path = campaign_path("rover-camera-faults")
    assert path is not None
    read = load_campaign(path)
    entries = {entry.kind for case in read.cases() if (entry := read.entry_of(case))}
    assert entries == {"freeze", "blackout", "dropout", "duplicate", "dirt", "glare"}
    assert {dict(case.axes)["slip_compensation"] for case in read.cases()} == {"crab", "heading"}


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (HEAD, r"key 'fault' is missing"),
        ("[[faults]]\n" + HEAD, r"unknown key 'faults'; did you mean 'fault'\?"),
        (HEAD + BIAS.replace("gyro_bias", "gyro_bais"), r"unknown fault 'gyro_bais'; did you mean 'gyro_bias'"),
        (HEAD + BIAS.replace("[1, 5]", "[1, 5000]"), r"gyro_bias:5000@6\+2: .*bias = 5000"),
        (HEAD + BIAS.replace("[1, 5]", "[1, 1]"), r"fault.0.amounts: must be a list of different values"),
        (HEAD + BIAS.replace("[6, 8]", '["soon"]'), r"gyro_bias:1@soon\+2"),
        (HEAD + BIAS + BIAS, r"fault gyro_bias is named twice"),
        (HEAD + BIAS + 'name = "none"\n', r"fault none: a name"),
        (HEAD + BIAS + "seeds = [3]\n", r"seed 3 is none of the campaign's seeds"),
        (HEAD + BIAS + "only.surface.fricton = 0.3\n", r"only.surface.fricton; did you mean 'surface.friction'"),
        (HEAD + BIAS + "only.surface.friction = 0.4\n", r"only.surface.friction: 0.4"),
        (HEAD.replace("true_max_m", "true_mx_m") + BIAS, r"did you mean 'off_tracking.true_max_m'"),
        (HEAD.replace("time_to_detect_s = 1", "time_to_detect_s = 0") + BIAS, r"time_to_detect_s = 0 must be above 0"),
        (HEAD.replace('"timed out"', '"crashed"') + BIAS, r"outcomes: crashed"),
        (HEAD + DRAWN.replace("[sample]\ncount = 8\n", ""), r"a table \[sample\]"),
        (HEAD + DRAWN.replace("uniform", "uniformly"), r"expected a distribution"),
        (HEAD + BIAS + "[stop]\nhalf_width = 0.1\n", r"\[stop\] is for drawn values"),
        (HEAD + BIAS + BISECT.format("dropout", 0, 1), r"bisect.fault = dropout"),
        (HEAD + BIAS + BISECT.format("gyro_bias", 2, 1), r"low = 2 must be below"),
        (HEAD + BIAS + BISECT.format("gyro_bias", 0, 900), r"bias = 900"),
        (HEAD + DRAWN + BISECT.format("dropout", 0, 1), r"onset or duration is drawn"),
        (HEAD + BIAS + "[accept]\nprobability = 1.5\n", r"accept.probability = 1.5 must be less than 1"),
    ],
)  # fmt: skip
def test_a_wrong_campaign_is_refused_in_one_line(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(ValueError, match=r"^campaign [^\n]+$|^study [^\n]+$") as refusal:
        campaign(tmp_path, text)
    assert refusal.match(f".*{says}")


def test_the_shipped_campaign_of_stereo_cameras_compares_three_laws_on_two_surfaces() -> None:
    """Outages of half a second to two, and lasting faults of images, each for both frictions and all seeds."""
    path = campaign_path("trailer-camera-faults")
    assert path is not None
    cases = load_campaign(path).cases()
    assert len(cases) == 15 * 2 * 3 * 3  # with the runs without a fault
    assert {dict(case.axes)["trailer_steering"] for case in cases} == {"path_preview", "mpc", "virtual_driver"}
