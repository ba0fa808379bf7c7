"""The site: it is built without a warning, needs no network, and its reference has all that the code has."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Final

import pytest

from offtrack.reports.sections import groups
from scenarios.part_listing import keys, parts
from vehicle.combination.unit import Axle, Brakes, Suspension, Unit
from vehicle.rover.description import Rover, RoverWheel, Soil
from vehicle.tyres.laws import TmeasyTyre

ROOT: Final = Path(__file__).resolve().parents[2]
LOADED: Final = re.compile(r"<(?:script|link|img)[^>]*(?:src|href)=\"(?:https?:)?//", re.IGNORECASE)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, with warnings as errors."""
    pytest.importorskip("myst_parser")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html", "-c", "docs", ".", str(folder)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=600)
    assert built.returncode == 0, built.stderr
    return folder


def test_the_first_page_leads_to_the_site_and_no_page_loads_anything_from_elsewhere(site: Path) -> None:
    (target,) = re.findall(r"url=([^\"]+)", (site / "index.html").read_text("utf-8"))
    assert (site / target).exists()
    pages = list(site.rglob("*.html"))
    assert len(pages) > 20
    assert [page.name for page in pages if LOADED.search(page.read_text("utf-8"))] == []


def test_the_reference_has_every_key_part_and_number(site: Path) -> None:
    """The text of a page is compared without its tags, so that line breaks in code do not matter."""

    def raw(name: str) -> str:
        return (site / "docs" / "reference" / f"{name}.html").read_text("utf-8")

    def page(name: str) -> str:
        return re.sub(r"<[^>]+>", "", raw(name))

    assert [key.name for key in keys() if key.name not in page("keys")] == []
    assert [part.name for part in parts() if part.name not in page("parts")] == []
    for table in (Unit, Axle, Suspension, Brakes, Rover, RoverWheel, Soil, TmeasyTyre):
        fields = set(table.model_fields) - {"origin_x", "lifted_axles"}  # which no file has
        assert {name for name in fields if f"\n{name}\n" not in page("vehicles")} == set()
    empty = re.findall(r"<tr[^>]*>\s*<td>.*?</td>\s*(?:<td>.*?</td>\s*){3}<td>(?:<p>\s*</p>)?\s*</td>", raw("vehicles"))
    assert empty == []
    assert [key for group in groups().values() for key in group.numbers if key not in page("summary")] == []
    for command in ("offtrack run", "offtrack fmu plant", "offtrack estimate slip"):
        assert f"{command} [OPTIONS]" in page("commands")
    for signal in ("off_tracking_true", "right_camera_delay_std", "fallback", "slip_angle_estimate"):
        assert signal in page("signals")
