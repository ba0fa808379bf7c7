"""Options, import paths and arguments that are wrong in every way: one line, exit code 2, nothing written."""

import re
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from offtrack.commands.cli import app
from offtrack.commands.console import PlainConsole, printable
from scenarios import catalogue
from scenarios.catalogue import resolve
from scenarios.options.scenario import Scenario, load_any_scenario, load_scenario
from vehicle.combination.description import load_vehicle, vehicle_from
from vehicle.foundation.user_file import ParameterLibrary, nearest, read_toml, without_sources

ESC = "\x1b[31m"
KINDS = (
    *(catalogue.TRAILER_STEERING, catalogue.ODOMETRY, catalogue.OFF_TRACKING, catalogue.SLIP_ESTIMATOR),
    *(catalogue.SENSOR, catalogue.ROVER_SENSOR, catalogue.DRIVER, catalogue.ROVER_DRIVER, catalogue.PLANT),
    catalogue.FAULT,
)
OWN = """
class NoStep:
    def init(self): ...

class MakesNothing:
    @classmethod
    def of(cls, context): return None

class Fails:
    @classmethod
    def of(cls, context): raise KeyError("spring")

class FailingLaw:
    def __init__(self, trailer): raise KeyError("spring")
    def init(self): ...
    def step(self, *arguments): ...

class WrongOptions:
    sensor, options = "reference_pose", 5
    @classmethod
    def of(cls, context): return cls()
    def init(self): ...
    def step(self, memory, message): ...

number = 5
"""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))  # the catalogue adds the working directory
    (tmp_path / "wrong_parts.py").write_text(OWN, encoding="utf-8")
    (tmp_path / "raising_part.py").write_text("raise RuntimeError('two\\nlines')", encoding="utf-8")
    (tmp_path / "leaving_part.py").write_text("import sys; sys.exit(0)", encoding="utf-8")
    (tmp_path / "importing_part.py").write_text("import no_such_library", encoding="utf-8")
    (tmp_path / "folder_part").mkdir()
    return tmp_path


def invoked(*arguments: str) -> Result:
    return CliRunner().invoke(app, arguments)


def refused(*arguments: str) -> str:
    """The one line of a refusal; nothing is written."""
    before = sorted(path for path in Path.cwd().rglob("*") if path.suffix != ".pyc" and path.name != "__pycache__")
    done = invoked(*arguments)
    assert done.exit_code == 2, (arguments, done.output, done.exception)
    line = done.stderr.removesuffix("\n")
    assert line.isprintable(), line  # neither line breaks nor escape codes
    assert line.startswith("offtrack: ")
    assert len(line) < 1100
    after = sorted(path for path in Path.cwd().rglob("*") if path.suffix != ".pyc" and path.name != "__pycache__")
    assert after == before
    return line


def refused_settings(*settings: str, scenario: str = "roundabout") -> str:
    return refused("run", scenario, "--quiet", *(part for setting in settings for part in ("--set", setting)))


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ("a." * 10_000 + "a=1", "at most 200 characters and 32 parts"),
        ("a." * 40 + "a=1", "at most 200 characters and 32 parts"),
        ("speed_kmh=" + "[" * 5000 + "]" * 5000, "must be a number"),
        ("speed_kmh=12\nsurface.friction=0.3", "one KEY=VALUE without line breaks"),
        ("speed_kmh=1" + "0" * 6000, "must be a number"),
        ("rig.width=1" + "0" * 400, "must be a whole number"),
        ('"speed_kmh"=1', "unknown key"),
        ("surface..friction=1", "expected KEY=VALUE"),
        ("=1", "expected KEY=VALUE"),
        (f"off_tracking={ESC}x", r"off_tracking=\x1b[31mx"),
        (f"{ESC}=1", "without line breaks or control characters"),
        ("drehzahl_ü=1", "unknown key 'drehzahl_ü'"),
        ("zzzzzz=1", "offtrack keys lists all"),
        ("name=" + "x" * 300, "at most 100 characters"),
        ("vehicle=" + "x" * 5000, "unknown vehicle"),
    ],
)
def test_settings_that_are_no_settings_are_refused(setting: str, says: str, here: Path) -> None:
    """Deep nesting, line breaks, thousands of digits, empty parts, escape codes, names of any length."""
    assert says in refused_settings(setting)


NUMBERS = [
    "speed_kmh",
    "rig.width",
    "course.radius",
    "surface.friction",
    "plant.mass_scale",
    "driver.max_lateral_acceleration",
    "degradation.hold",
    "viso_ot.reversing_distance",
    "signals.noise",
    "traffic.gap",
    "ground_rig.front",
]
ROVER_NUMBERS = ["speed_kmh", "course.length", "rig.noise", "surface.grade", "signals.noise"]


@pytest.mark.parametrize("value", ["true", "nan", "inf", "-inf", "fast"])
def test_only_finite_numbers_are_numbers(value: str) -> None:
    """In every table, in trailers' and rovers' scenarios; a boolean is not 1."""
    settings = [("roundabout", key, f"{key}={value}") for key in NUMBERS]
    settings += [("rover-slope", key, f"{key}={value}") for key in ROVER_NUMBERS]
    settings += [("roundabout", "rig.misrotation_deg", f"rig.misrotation_deg=[0, 0, {value}]")]
    if value != "fast":
        settings += [("roundabout", "faults.0.amount", f"faults=[{{kind='dropout', amount={value}}}]")]
        settings += [("roundabout", "faults.0.start", f"faults=[{{kind='dropout', start={value}}}]")]
    if value not in ("fast", "true"):
        settings += [
            ("roundabout", "sensing.x", f"sensing.x={value}"),
            ("rover-slope", "driving.x", f"driving.x={value}"),
        ]
        settings += [("roundabout", "driver.parameters.x", f"driver.parameters.x={value}")]
    for scenario, key, setting in settings:
        with pytest.raises(ValueError, match=rf"scenario {scenario}: {key}.* must be") as error:
            load_any_scenario(scenario, [setting])
        assert "\n" not in str(error.value)


def test_numbers_of_vehicle_and_law_are_finite_numbers_too(here: Path) -> None:
    for key in ("steering.gain", "plant.units.0.mass"):
        for value in ("true", "nan", "1" + "0" * 400):
            assert key in refused_settings(f"{key}={value}", "off_tracking=truth")


def test_booleans_in_files_are_no_numbers_either(here: Path) -> None:
    text = load_scenario("roundabout").to_toml().replace("speed_kmh = 10.0", "speed_kmh = true")
    (here / "mine.toml").write_text(text, encoding="utf-8")
    assert "speed_kmh = True must be a number between 1 and 120 km/h" in refused("run", "mine.toml", "--quiet")


def test_what_was_a_number_still_is() -> None:
    """Integers for numbers, a bare decimal point, capitals of true; lists of any option."""
    scenario = load_scenario(
        "roundabout",
        [
            *("speed_kmh=12", "surface.friction=.5", "signals.noise=2.", "rig.noise=+1.5", "world.overcast=True"),
            *("rig.misrotation_deg=[0, 0, 1]", "faults=dropout:0.1@5+2;freeze", "driver.stops=[{station=20, wait=1}]"),
        ],
    )
    assert (scenario.speed_kmh, scenario.surface.friction, scenario.signals.noise) == (12.0, 0.5, 2.0)
    assert scenario.rig.noise == 1.5
    assert scenario.world.overcast
    assert scenario.rig.misrotation_deg == (0.0, 0.0, 1.0)
    assert (scenario.faults[0].amount, scenario.faults[0].start, scenario.faults[0].duration) == ((0.1,), 5.0, 2.0)
    assert scenario.driver.stops[0].station == 20.0


def test_of_a_key_given_twice_the_last_counts_and_a_course_keeps_its_keys() -> None:
    assert load_scenario("roundabout", ["speed_kmh=8", "speed_kmh=9"]).speed_kmh == 9.0
    for settings in (["course.length=33", "course.kind=straight"], ["course.kind=straight", "course.length=33"]):
        scenario = load_any_scenario("roundabout", settings)
        assert isinstance(scenario, Scenario)
        assert scenario.course.model_dump() == {"kind": "straight", "length": 33.0}


@pytest.mark.parametrize(
    ("path", "says"),
    [
        ("os:system", "is no class"),
        ("wrong_parts:number", "is no class"),
        ("wrong_parts:Missing", "module wrong_parts has no 'Missing'"),
        ("folder_part:Law", "folder folder_part has no 'Law'"),
        ("..:x", "must be package.module:Name"),
        ("a:b.c", "must be package.module:Name"),
        ("a.b", "unknown name 'a.b'"),
        ("no_such_module:Law", "no module no_such_module"),
        ("raising_part:Law", r"importing raising_part failed: RuntimeError: two\nlines"),
        ("leaving_part:Law", "importing leaving_part failed: SystemExit"),
        (
            "importing_part:Law",
            "importing importing_part failed: ModuleNotFoundError: No module named 'no_such_library'",
        ),
    ],
)
def test_import_paths_that_name_no_part_are_refused(path: str, says: str, here: Path) -> None:
    """For every kind of part; nothing of what the path names is called."""
    for names in KINDS:
        with pytest.raises(ValueError, match=re.escape(says.replace("\\n", "\n"))):
            resolve("key", path, names)
    assert says in refused_settings(f"trailer_steering={path}", "off_tracking=truth")


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ("trailer_steering=wrong_parts:NoStep", "the class lacks the method step"),
        ("trailer_steering=os:PathLike", "the class lacks the method init, the method step"),
        ("trailer_steering=wrong_parts:FailingLaw", "KeyError: 'spring'"),
        ("off_tracking=wrong_parts:NoStep", "the declaration 'sensor'"),
        ("off_tracking=wrong_parts:WrongOptions", "'options' must be a tuple of vehicle.option.Option"),
        ("driver.kind=wrong_parts:MakesNothing", "made a NoneType, which has no method init, step"),
        ("sensor=wrong_parts:MakesNothing", "made a NoneType, which has no method sample"),
        ("plant.kind=wrong_parts:MakesNothing", "made a NoneType, which has no method initial_state, step, observe"),
        ("plant.kind=wrong_parts:Fails", "KeyError: 'spring'"),
        ("faults=os:system", "is no class"),
        ("course.kind=os:system", "is no class"),
        ("course.kind=wrong_parts:Fails", "must be derived from scenarios.options.course.CourseOptions"),
    ],
)
def test_classes_without_the_methods_of_their_kind_are_refused(setting: str, says: str, here: Path) -> None:
    others = [] if setting.startswith("off_tracking") else ["off_tracking=truth"]
    assert says in refused_settings(setting, *others)


@pytest.mark.parametrize(
    "arguments",
    [
        ("parts", "nonsense"),
        ("parts", ESC),
        ("keys", "nonsense"),
        ("scenarios", "n" * 300 + ".toml"),
        ("nonsense",),
        ("run",),
        ("run", "roundabout", "--set"),
        ("run", "roundabout", "--seed", "-1"),
        ("run", "roundabout", "--seed", "9" * 5000),
        ("run", "roundabout", f"--{ESC}"),
        ("run", "roundabout", "--out", ""),
        ("run", "roundabout", "--out", "raising_part.py"),
        ("run", "roundabout", "--out", "n" * 300),
        ("run", "roundabout", "--out", f"{ESC}red"),
        ("vehicle", "rigid_truck", "--out", "n" * 240),
        ("estimate", "off-tracking", "nowhere", "--out", ""),
        ("calibrate", "nowhere"),
    ],
)
def test_arguments_of_every_command_end_in_one_line(arguments: tuple[str, ...], here: Path) -> None:
    refused(*arguments)


def test_names_with_brackets_are_printed_as_they_are(here: Path) -> None:
    done = invoked("vehicle", "rigid_truck", "--out", "a[/b]c")
    assert done.exit_code == 0, done.output
    assert "a[/b]c/sheet.svg" in done.stdout.replace("\n", "")
    console = PlainConsole()
    with console.capture() as captured:
        console.print(f"[/red] {ESC}:snake: two\nlines")
    assert captured.get() == "[/red] \\x1b[31m:snake: two\nlines\n"
    assert printable("\x9b2J\u202e") == "\\x9b2J\\u202e"


def truck(**changes: str) -> dict[str, object]:
    library = ParameterLibrary("vehicle", "parameters")
    contents = without_sources(read_toml(library.file("b_double")))
    for index, name in changes.items():
        contents["units"][int(index.removeprefix("unit_"))]["name"] = name
    return dict(contents)


@pytest.mark.parametrize("name", ["a/b", "", "x" * 41, "a.b", "0", "1st", "two\nlines", ESC, "a,b", "[b]", "trailer "])
def test_names_of_units_must_fit_into_columns(name: str) -> None:
    with pytest.raises(ValueError, match=r"units.1.name: '.*' must be letters, digits, spaces") as error:
        vehicle_from(truck(unit_1=name), "mine.toml")
    assert str(error.value).isprintable()


def test_names_of_units_are_different_and_no_endings_of_signals() -> None:
    """A space and an underscore are the same in paths; some words are endings of signal names."""
    for first, second in (("trailer", "trailer"), ("lead trailer", "lead_trailer")):
        with pytest.raises(ValueError, match="two have the name"):
            vehicle_from(truck(unit_1=first, unit_2=second), "mine.toml")
    with pytest.raises(ValueError, match="'command' is an ending of signal names"):
        vehicle_from(truck(unit_2="command"), "mine.toml")
    assert vehicle_from(truck(unit_2="släp 2"), "mine.toml").units[2].name == "släp 2"
    assert load_vehicle("b_double").units[2].name


def test_a_word_unlike_all_others_is_answered_with_few_of_them() -> None:
    words = [f"word_{k}" for k in range(60)]
    assert nearest("zzz", words).count("word_") == 3
    assert nearest("zzz", words[:4]).count("word_") == 4
    assert nearest("word_" * 100_000, words).count("word_") <= 3
