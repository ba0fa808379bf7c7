"""Reference lines of OpenDRIVE against SUMO's netconvert, which must be on the path: ``pip install eclipse-sumo``.

``OFFTRACK_ROADS`` may name a folder with more files (``*.xodr``) of one road each.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from scenarios.roads.opendrive.file import read_opendrive
from tests.open_drive import TWO_LANES, file

_GEOMETRY = (
    ("<line/>", 30.0, "0", "0", "0"),
    ('<spiral curvStart="0" curvEnd="0.04"/>', 40.0, "30", "0", "0"),
)


def spiral() -> str:
    """A line and a spiral."""
    rows, s = "", 0.0
    for shape, length, x, y, heading in _GEOMETRY:
        rows += f'<geometry s="{s}" x="{x}" y="{y}" hdg="{heading}" length="{length}">{shape}</geometry>'
        s += length
    return file(f'<road id="1" length="{s}" junction="-1"><planView>{rows}</planView>{TWO_LANES}</road>')


def cubic(kind: str, end: float) -> str:
    """A parametric cubic."""
    numbers = f'aU="0" bU="{29.9 / end}" cU="0" dU="0" aV="0" bV="0" cV="{4.0 / end**2}" dV="{-2.0 / end**3}"'
    shape = f'<paramPoly3 pRange="{kind}" {numbers}/>'
    plan = f'<planView><geometry s="0" x="5" y="2" hdg="0.3" length="30">{shape}</geometry></planView>'
    return file(f'<road id="1" length="30" junction="-1">{plan}{TWO_LANES}</road>')


def files(folder: Path) -> list[Path]:
    """Files to compare."""
    for name, text in (
        ("spiral", spiral()),
        ("normalized", cubic("normalized", 1.0)),
        ("arc", cubic("arcLength", 30.0)),
    ):
        (folder / f"{name}.xodr").write_text(text, encoding="utf-8")
    more = os.environ.get("OFFTRACK_ROADS")
    return [*sorted(folder.glob("*.xodr")), *(sorted(Path(more).glob("*.xodr")) if more else ())]


@pytest.mark.skipif(shutil.which("netconvert") is None, reason="netconvert is not installed")
def test_reference_lines_are_where_netconvert_has_them(tmp_path: Path) -> None:
    """Within 20 mm, but for the offset of its edges' centre in roads of other files whose lanes are not symmetric."""
    for path in files(tmp_path):
        plain = str(tmp_path / f"{path.stem}-plain")
        exact = ("--opendrive.curve-resolution", "0.5", "--precision", "6", "--offset.disable-normalization", "true")
        subprocess.run(
            ["netconvert", "--opendrive-files", str(path), "--plain-output-prefix", plain, *exact],
            check=True,
            capture_output=True,
        )
        (road,) = read_opendrive(path).roads.values()
        s = np.append(np.arange(0.0, road.reference.length, 0.002), road.reference.length)
        tree = KDTree(road.reference.poses(s)[:, :2])
        for edge in ET.parse(f"{plain}.edg.xml").getroot().iter("edge"):
            shape = [[float(number) for number in point.split(",")[:2]] for point in edge.get("shape", "").split()]
            if shape:
                distance, _ = tree.query(np.array(shape))
                aside = np.min(distance) if path.parent != tmp_path else 0.0
                assert np.max(distance) - aside < 0.02, path.name
