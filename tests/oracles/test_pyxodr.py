"""Reference lines of OpenDRIVE against pyxodr: ``pip install pyxodr``.

``OFFTRACK_ROADS`` may name a folder with more files (``*.xodr``).
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from scenarios.roads.opendrive.file import read_opendrive
from tests.open_drive import TWO_LANES, file

network = pytest.importorskip("pyxodr.road_objects.network", reason="pyxodr is not installed: pip install pyxodr")

_FINE = 0.002  # between points of either line [m]


def _written(folder: Path) -> list[Path]:
    """A spiral between a line and an arc, and the files of the folder that the user names."""
    rows = (
        '<geometry s="0" x="0" y="0" hdg="0.2" length="30"><line/></geometry>'
        f'<geometry s="30" x="{30 * np.cos(0.2)}" y="{30 * np.sin(0.2)}" hdg="0.2" length="40">'
        '<spiral curvStart="0" curvEnd="0.04"/></geometry>'
    )
    text = file(f'<road id="1" length="70" junction="-1"><planView>{rows}</planView>{TWO_LANES}</road>')
    (folder / "spiral.xodr").write_text(text, encoding="utf-8")
    more = os.environ.get("OFFTRACK_ROADS")
    return [*folder.glob("*.xodr"), *(sorted(Path(more).glob("*.xodr")) if more else ())]


def test_points_are_where_pyxodr_has_them(tmp_path: Path) -> None:
    """Each of its points lies within 1 mm of our line, and so does our line of its points."""
    for path in _written(tmp_path):
        ours = read_opendrive(path).roads
        for road in network.RoadNetwork(str(path), resolution=_FINE).get_roads():
            line = ours[road.id].reference
            s = np.append(np.arange(0.0, line.length, _FINE), line.length)
            points, theirs = line.poses(s)[:, :2], np.asarray(road.reference_line)[:, :2]
            for near, far in ((points, theirs), (theirs, points)):
                # between two points of a line that are 2 mm apart, half of that is along the line
                assert np.max(KDTree(near).query(far)[0]) < np.hypot(1e-3, 0.51 * _FINE), (path.name, road.id)
