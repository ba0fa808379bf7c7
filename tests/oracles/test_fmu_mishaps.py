"""Everything that an FMU can do wrong at its start, in a step and at its end: one line each, and no process left."""

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from offtrack.exchange.fmi_import import instance as process
from offtrack.exchange.fmi_import.fmu_file import open_fmu
from offtrack.exchange.fmi_import.fmu_parts import law_signals
from offtrack.exchange.fmi_import.instance import FmuError, FmuInstance
from offtrack.exchange.fmi_import.mapping import map_file, read_map
from tests.fmus.models import END_MISHAPS, LAW, LAW_CODE, MISHAPS, STEP_MISHAPS, build_fmu

IN_STEPS = {
    "crash": "its process was ended by SIGSEGV",
    "endless": "does not return within 0.5 s",
    "nan": "its output steer_demand_1 is nan",
    "error": "failed with status 3 (error)",
    "exit": "its process exited (7)",
    "infinite": "its output steer_demand_1 is inf",
    "discard": "failed with status 2 (discard)",
    "fatal": "failed with status 4 (fatal)",
    "pending": "failed with status 5 (pending)",
    "abort": "its process was ended by SIGABRT",
    "success": "its process exited (0)",
    "recursion": "its process was ended by SIGSEGV",
    "killed": "its process was ended by SIGKILL",
    "closed": "its process closed the connection",
    "chatter": "failed with status 3 (error)",
    "binary": "failed with status 3 (error)",
}
AT_START = {
    "start crash": "its process was ended by SIGSEGV",
    "start endless": "does not return within 2 s",
    "start error": "ExitInitializationMode failed with status 3 (error)",
    "start exit": "its process exited (9)",
    "start discard": "ExitInitializationMode failed with status 2 (discard)",
}


@pytest.fixture(autouse=True)
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    before = children()
    yield
    assert children() == before
    assert list(tmp_path.glob("offtrack-*")) == []


def children() -> set[int]:
    return {int(number) for number in Path("/proc/thread-self/children").read_text().split()}


@pytest.fixture(scope="module")
def laws(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    folder = tmp_path_factory.mktemp("laws")
    files = {2: build_fmu(folder, "law2", LAW, LAW_CODE), 3: build_fmu(folder, "law3", LAW, LAW_CODE, version=3)}
    for file in files.values():
        outputs = '[outputs]\nsteer_demand_1 = "steer_demand_1"\nsteer_demand_2 = "steer_demand_2"\n'
        text = f'timeout = 0.5\n[inputs]\noff_tracking = "off_tracking"\n{outputs}'
        map_file(file).write_text(text, encoding="utf-8")
    return files


def opened(file: Path, mishap: str) -> FmuInstance:
    fmu = open_fmu(file)
    return FmuInstance(fmu, read_map(fmu, law_signals(2, 2)), {"mishap": float(MISHAPS[mishap]), "mishap_at": 0.05})


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("mishap", STEP_MISHAPS)
def test_a_mishap_in_a_step_is_one_line(laws: dict[int, Path], mishap: str, version: int) -> None:
    instance, begin = opened(laws[version], mishap), time.monotonic()
    for _ in range(5):
        instance.step(10, {"off_tracking": 0.1})
    with pytest.raises(FmuError) as caught:
        instance.step(10, {"off_tracking": 0.1})
    instance.close()
    text = str(caught.value)
    assert text.startswith(f"{laws[version]}: at 0.05 s")
    assert IN_STEPS[mishap] in text
    assert text.isprintable()
    assert time.monotonic() - begin < 20.0


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("mishap", AT_START)
def test_a_mishap_at_the_start_is_one_line(
    laws: dict[int, Path], mishap: str, version: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process, "_START", 2.0)
    with pytest.raises(ValueError, match="cannot be started") as caught:
        opened(laws[version], mishap)
    assert AT_START[mishap] in str(caught.value)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("version", [2, 3])
def test_an_output_that_is_no_number_at_the_start_is_one_line(laws: dict[int, Path], version: int) -> None:
    """It is noticed when the loop first asks for it."""
    instance = opened(laws[version], "start nan")
    with pytest.raises(FmuError, match="at 0 s its output steer_demand_1 is nan"):
        instance.outputs({"off_tracking": 0.1})
    instance.close()


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("mishap", END_MISHAPS)
def test_a_mishap_at_the_end_costs_no_more_than_some_seconds(laws: dict[int, Path], mishap: str, version: int) -> None:
    instance = opened(laws[version], mishap)
    assert instance.step(10, {"off_tracking": 0.1})["steer_demand_1"] == pytest.approx(0.02)
    begin = time.monotonic()
    instance.close()
    assert time.monotonic() - begin < 10.0
