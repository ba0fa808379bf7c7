"""Reference lines of OpenDRIVE against SUMO's netconvert (``pip install eclipse-sumo``) and against pyxodr.

``OFFTRACK_ROADS`` may name a folder with more files (``*.xodr``); netconvert takes those of one road each.
"""

import os
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from scenarios.roads.opendrive.file import read_opendrive
from tests.open_drive import TWO_LANES, file

FINE = 0.002  # between points of a line [m]
SPIRAL = (
    '<geometry s="0" x="0" y="0" hdg="0" length="30"><line/></geometry><geometry s="30" x="30" y="0" hdg="0" '
    'length="40"><spiral curvStart="0" curvEnd="0.04"/></geometry>'
)


def cubic(kind: str, end: float) -> str:
    numbers = f'aU="0" bU="{29.9 / end}" cU="0" dU="0" aV="0" bV="0" cV="{4.0 / end**2}" dV="{-2.0 / end**3}"'
    return f'<geometry s="0" x="5" y="2" hdg="0.3" length="30"><paramPoly3 pRange="{kind}" {numbers}/></geometry>'


PLANS = {"spiral": (SPIRAL, 70), "normalized": (cubic("normalized", 1.0), 30), "arc": (cubic("arcLength", 30.0), 30)}


def roads(folder: Path, *names: str) -> list[Path]:
    for name in names:
        plan, length = PLANS[name]
        road = f'<road id="1" length="{length}" junction="-1"><planView>{plan}</planView>{TWO_LANES}</road>'
        (folder / f"{name}.xodr").write_text(file(road), encoding="utf-8")
    more = os.environ.get("OFFTRACK_ROADS")
    return [*sorted(folder.glob("*.xodr")), *(sorted(Path(more).glob("*.xodr")) if more else ())]


# in the folder of this Python, where pip installs commands
NETCONVERT = shutil.which("netconvert", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))


@pytest.mark.skipif(NETCONVERT is None, reason="netconvert is not installed")
def test_reference_lines_are_where_netconvert_has_them(tmp_path: Path) -> None:
    """Within 20 mm, but for the offset of its edges' centre in roads of other files whose lanes are not symmetric."""
    for path in roads(tmp_path, *PLANS):
        plain = str(tmp_path / f"{path.stem}-plain")
        exact = ("--opendrive.curve-resolution", "0.5", "--precision", "6", "--offset.disable-normalization", "true")
        command = [str(NETCONVERT), "--opendrive-files", str(path), "--plain-output-prefix", plain, *exact]
        subprocess.run(command, check=True, capture_output=True)
        (road,) = read_opendrive(path).roads.values()
        s = np.append(np.arange(0.0, road.reference.length, FINE), road.reference.length)
        tree = KDTree(road.reference.poses(s)[:, :2])
        for edge in ET.parse(f"{plain}.edg.xml").getroot().iter("edge"):
            shape = [[float(number) for number in point.split(",")[:2]] for point in edge.get("shape", "").split()]
            if shape:
                distance, _ = tree.query(np.array(shape))
                aside = np.min(distance) if path.parent != tmp_path else 0.0
                assert np.max(distance) - aside < 0.02, path.name


def test_points_are_where_pyxodr_has_them(tmp_path: Path) -> None:
    """Each of its points lies within 1 mm of our line, and so does our line of its points."""
    network = pytest.importorskip("pyxodr.road_objects.network", reason="pyxodr is not installed: pip install pyxodr")
    for path in roads(tmp_path, "spiral"):
        ours = read_opendrive(path).roads
        for road in network.RoadNetwork(str(path), resolution=FINE).get_roads():
            line = ours[road.id].reference
            s = np.append(np.arange(0.0, line.length, FINE), line.length)
            points, theirs = line.poses(s)[:, :2], np.asarray(road.reference_line)[:, :2]
            for near, far in ((points, theirs), (theirs, points)):
                # between two points of a line that are 2 mm apart, half of that is along the line
                assert np.max(KDTree(near).query(far)[0]) < np.hypot(1e-3, 0.51 * FINE), (path.name, road.id)
