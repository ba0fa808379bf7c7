"""Options that a replaceable part declares."""

from __future__ import annotations

import pytest

from estimators.protocol import Option, Parameter, option_values

OPTIONS = (
    Option(name="gain", default=0.5, unit="rad/m", low=0.0, high=2.0, meaning="turn per offset"),
    Option(name="frames", default=3, low=1, meaning="number of frames"),
    Option(name="smoothing", default=False, meaning="Kalman filter"),
    Option(name="kind", default="linear", meaning="interpolation"),
)


def test_options_not_given_keep_their_defaults() -> None:
    assert option_values(OPTIONS, {"gain": 1}, "steering") == {
        "gain": 1,
        "frames": 3,
        "smoothing": False,
        "kind": "linear",
    }


@pytest.mark.parametrize(
    ("name", "value", "complaint"),
    [
        ("gian", 1.0, r"unknown option 'steering\.gian'.*gain"),
        ("gain", 2.5, r"steering\.gain = 2\.5 must be 0 to 2 \[rad/m\]"),
        ("gain", float("nan"), r"steering\.gain = nan must be 0 to 2"),
        ("gain", True, r"steering\.gain = True must be of type float"),
        ("gain", "high", r"steering\.gain = 'high' must be of type float"),
        ("frames", 0, r"steering\.frames = 0 must be at least 1 \[-\]"),
        ("frames", 2.0, r"steering\.frames = 2\.0 must be of type int"),
        ("smoothing", 1, r"steering\.smoothing = 1 must be of type bool"),
        ("kind", 1, r"steering\.kind = 1 must be of type str"),
    ],
)
def test_wrong_options_are_refused_in_one_line(name: str, value: Parameter, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint) as caught:
        option_values(OPTIONS, {name: value}, "steering")
    assert "\n" not in str(caught.value)
