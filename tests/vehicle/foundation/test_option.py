"""Declared parameters of replaceable parts."""

import pytest

from vehicle.option import Option, Parameter, check_options, option_values

GAIN = Option(name="gain", default=0.5, unit="rad/m", low=0.0, high=2.0, meaning="turn per offset")
COUNT = Option(name="count", default=3, low=1, meaning="number of frames")
MODE = Option(name="mode", default="a", choices=("a", "b"), meaning="mode")
LENGTH = Option(name="length", default=None, unit="m", low=0.1, meaning="length", default_text="half of it")
FLAG = Option(name="flag", default=False, meaning="switch")


@pytest.mark.parametrize(
    ("option", "value"), [(GAIN, 0.0), (GAIN, 2), (COUNT, 1), (MODE, "b"), (LENGTH, 4.0), (FLAG, True)]
)
def test_values_within_the_limits_are_accepted(option: Option, value: Parameter) -> None:
    option.check(value, option.name)


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        (GAIN, 2.1, r"^gain = 2.1 rad/m must be between 0 and 2 rad/m$"),
        (GAIN, float("nan"), r"^gain = nan rad/m must be between 0 and 2 rad/m$"),
        (GAIN, "high", r"^gain = 'high' must be a number between 0 and 2 rad/m$"),
        (GAIN, 10**400, r"^gain = 10{3,150}\.\.\. rad/m must be between 0 and 2 rad/m$"),
        (GAIN, True, r"^gain = True must be a number between 0 and 2 rad/m$"),
        (COUNT, 0, r"^count = 0 must be at least 1$"),
        (COUNT, 2.5, r"^count = 2.5 must be a whole number, at least 1$"),
        (LENGTH, float("inf"), r"^length = inf m must be at least 0.1 m$"),
        (MODE, "c", r"^mode = 'c'.*known: a, b"),
        (FLAG, 1, r"^flag = 1 must be true or false$"),
    ],
)
def test_other_values_are_refused_in_one_line(option: Option, value: Parameter, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        option.check(value, option.name)


def test_values_are_completed_by_defaults_and_unknown_names_refused() -> None:
    assert option_values((GAIN, LENGTH), {}, "law") == {"gain": 0.5}
    assert option_values((GAIN, LENGTH), {"length": 1.0}, "law") == {"gain": 0.5, "length": 1.0}
    with pytest.raises(ValueError, match=r"^unknown key 'law\.gian'; did you mean 'gain'\?$"):
        option_values((GAIN,), {"gian": 1.0}, "law")
    with pytest.raises(ValueError, match=r"^gain = 3"):
        check_options((GAIN,), {"gain": 3.0})
