"""Courses along points of files: the fit, the road around it, and one line for every file that makes no course."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from controllers.path import Path as DrivenPath
from controllers.path import Segment, arc, line
from offtrack.studies.case import content
from offtrack.studies.validation.no_slip_limit import poses_along, rolling_chain
from scenarios.assembly.adapters import course_of, vehicle_of
from scenarios.courses import Course
from scenarios.loop.runner import run
from scenarios.options.rover_course import RoverPathOptions
from scenarios.options.scenario import load_scenario
from scenarios.results.swept_path import placed
from scenarios.roads import path_file
from scenarios.roads.earth import tangent_plane
from scenarios.roads.fitted_path import Fit, fitted_path, smooth_path
from scenarios.roads.path_file import PathPoints
from tests.open_drive import bend as arc_road
from vehicle.combination.description import load_vehicle
from vehicle.frames import FloatArray, Pose2

RADIUS = 12.5
RAD = math.pi / 180.0


def bend(radius: float = RADIUS, turn: float = math.pi, noise: float = 0.0, spacing: float = 1.0) -> FloatArray:
    """Points every metre on 30 m of straight, an arc to the left and 30 m of straight."""
    path = DrivenPath(Pose2(7.0, -3.0, 0.4), (line(30.0), arc(radius * turn, 1.0 / radius), line(30.0)))
    points: FloatArray = path.poses(np.arange(0.0, path.length, spacing))[:, :2]
    return points + noise * np.random.default_rng(5).normal(size=points.shape)


def csv(points: FloatArray, names: str = "x,y") -> str:
    return "\n".join([names, *(",".join(f"{number:.9f}" for number in row) for row in points.tolist())])


def on_earth(points: FloatArray) -> FloatArray:
    """Longitude and latitude [deg] near Cambridge, by the radii of curvature of the ellipsoid."""
    e2, latitude = 0.00669437999014, 52.2 * RAD
    w = math.sqrt(1.0 - e2 * math.sin(latitude) ** 2)
    across, along = 6378137.0 / w, 6378137.0 * (1.0 - e2) / w**3
    degrees: FloatArray = np.array([0.12, 52.2]) + points / np.array([across * math.cos(latitude), along]) / RAD
    return degrees


def gpx(points: FloatArray) -> str:
    rows = (f'<trkpt lat="{lat:.10f}" lon="{lon:.10f}"/>' for lon, lat in on_earth(points).tolist())
    return f'<gpx xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>{"".join(rows)}</trkseg></trk></gpx>'


def geojson(points: FloatArray) -> str:
    return f'{{"type": "LineString", "coordinates": {on_earth(points).tolist()}}}'


def settings(file: Path, *more: str) -> list[str]:
    return ["off_tracking=truth", "trailer_steering=none", "course.kind=path", f"course.file={file}", *more]


def course(folder: Path, text: str, *more: str, name: str = "path.csv") -> Course:
    (folder / name).write_text(text, encoding="utf-8")
    scenario = load_scenario("roundabout", settings(folder / name, *more))
    return course_of(scenario, vehicle_of(scenario))


def test_points_on_a_circle_give_its_curvature() -> None:
    """No change of curvature and no deviation: the fit has nothing to trade, so the circle is exact."""
    angles = np.arange(0.0, 6.0, 0.08)
    fitted = smooth_path(RADIUS * np.stack([np.cos(angles), np.sin(angles)], axis=1), 8.0)
    curvature = [segment.start_curvature for segment in fitted.path.segments]
    assert curvature == pytest.approx([1.0 / RADIUS] * len(curvature), abs=1e-6)  # knots see 1e-5 m of the fit's end
    assert np.abs(fitted.deviations).max() < 1e-5
    assert fitted.path.length == pytest.approx(RADIUS * angles[-1], abs=1e-4)


@pytest.mark.parametrize(("wavelength", "kept"), [(8.0, 1.0 / 2.0), (16.0, 64.0 / 65.0), (4.0, 1.0 / 65.0)])
def test_smoothing_keeps_of_a_wave_what_is_stated(wavelength: float, kept: float) -> None:
    """Minimising d^2 + (l/2pi)^6 (y''')^2 keeps 1 / (1 + (l/wavelength)^6) of a wave; measured away from the ends."""
    x = np.arange(0.0, 120.0, 0.25)
    wave = 0.01 * np.sin(math.tau * x / wavelength)
    fitted = smooth_path(np.stack([x, wave], axis=1), 8.0)
    inside = (x > 40.0) & (x < 80.0)
    remaining = (wave - fitted.deviations)[inside] @ wave[inside] / (wave[inside] @ wave[inside])
    assert remaining == pytest.approx(kept, abs=0.01)  # 40 m are whole waves but for the points' spacing


def test_the_curvature_of_a_fitted_path_has_no_jumps(tmp_path: Path) -> None:
    """The points jump from a line to an arc; the path ramps: over 1 m at most half of the arc's curvature."""
    path = course(tmp_path, csv(bend())).path
    curvature = np.array([path.curvature(s) for s in np.arange(0.0, path.length, 0.1)])
    assert np.abs(curvature[10:] - curvature[:-10]).max() < 0.5 / RADIUS
    assert curvature.max() == pytest.approx(1.0 / RADIUS, rel=0.08)  # the fit overshoots a jump, as sharp filters do


def test_a_line_with_points_only_at_its_ends_stays_straight(tmp_path: Path) -> None:
    points = bend()
    sparse = np.concatenate([points[:1], points[30:70], points[-1:]])
    path = course(tmp_path, csv(sparse)).path
    assert max(abs(path.curvature(s)) for s in np.arange(0.0, 22.0, 0.5)) < 1e-3


def test_many_close_points_are_one_path() -> None:
    """Points every 2 cm with 5 mm of noise turn back all the time, the path through them does not."""
    fit = Fit(source="points", smoothing=8.0, tolerance=0.05, shortest=10.0)
    fitted, _ = fitted_path(PathPoints(places=bend(noise=0.005, spacing=0.02)), fit)
    assert fitted.path.curvature(50.0) == pytest.approx(1.0 / RADIUS, rel=0.03)


def test_the_tangent_plane_keeps_distances_of_the_ellipsoid() -> None:
    """30 m along the parallel and the meridian at 52.2 deg, by their radii of curvature."""
    longitude, latitude = on_earth(np.array([[0.0, 0.0], [30.0, 0.0], [0.0, 30.0]])).T
    x, y = tangent_plane(latitude, longitude, np.zeros(3))[0].T
    assert (x[1] - x[0], y[2] - y[0]) == pytest.approx((30.0, 30.0), abs=1e-5)


def cut_in(driven: Course) -> float:
    """Largest distance of the last axle inside the path of an unsteered trailer without slip [m]."""
    vehicle = load_vehicle("uk_longer_semitrailer")
    poses = poses_along(rolling_chain(vehicle), driven.path, driven.reference)
    axle = min(a.x for a in vehicle.units[-1].axles)
    places = placed(np.array([[axle, 0.0]]), poses[:, -1])[:, 0]
    line = driven.path.poses(np.arange(-20.0, driven.length, 0.02))[:, :2]  # the trailer stands behind the start
    distances, _ = KDTree(line).query(places)
    return float(np.max(distances))


def test_one_circle_in_several_formats_gives_the_same_off_tracking(tmp_path: Path) -> None:
    """Points every metre, with 5 mm of noise as GPX, and an OpenDRIVE arc: the trailer cuts in alike, within 5 mm."""
    files = {"points.csv": csv(bend()), "track.gpx": gpx(bend(noise=0.005)), "line.geojson": geojson(bend())}
    cuts = [cut_in(course(tmp_path, text, name=name)) for name, text in files.items()]
    cuts.append(cut_in(course(tmp_path, arc_road(RADIUS, math.pi), "course.kind=opendrive", name="road.xodr")))
    assert cuts == pytest.approx([cuts[0]] * len(cuts), abs=0.005)
    assert cuts[0] > 3.0


def test_the_summary_states_the_deviation_of_the_path(tmp_path: Path) -> None:
    """A gentle bend driven to its end; the path keeps to its points within millimetres, and says so."""
    (tmp_path / "path.csv").write_text(csv(bend(60.0, 0.2)[15:-10]), encoding="utf-8")
    result = run(load_scenario("roundabout", settings(tmp_path / "path.csv", "speed_kmh=40")), 1)
    numbers = result.summary()
    assert numbers["outcome"] == "completed"
    assert result.path_deviation is not None
    of_course = numbers["course"]
    assert isinstance(of_course, dict)
    assert of_course["path_deviation_m"] == pytest.approx(result.path_deviation, abs=1e-5)
    assert 0.0 < result.path_deviation < 0.01


def test_a_path_of_too_many_points_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(path_file, "MAX_POINTS", 60)
    with pytest.raises(ValueError, match="a path must have 2 to 60"):
        course(tmp_path, csv(bend()))


@pytest.mark.parametrize(
    ("guided", "turn", "place"),
    [
        ("steered_axle", 1.0, ("axle", 0.0)),
        ("front_middle", 1.0, ("front", 0.0)),
        ("outer_front_corner", 1.0, ("front", -1.0)),
        ("outer_front_corner", -1.0, ("front", 1.0)),
    ],
)
def test_the_chosen_point_follows_the_path(tmp_path: Path, guided: str, turn: float, place: tuple[str, float]) -> None:
    """The outer corner is on the right in a turn to the left; the tractor starts at W's origin along x."""
    points = bend() * np.array([1.0, turn])
    driven = course(tmp_path, csv(points), f"course.guided={guided}")
    tractor = load_vehicle("uk_longer_semitrailer").units[0]
    x = {"axle": tractor.steered_axles[0].x, "front": tractor.front_x}[place[0]]
    assert driven.reference == pytest.approx((x, place[1] * 0.5 * tractor.width))
    assert driven.path.start == pytest.approx((*driven.reference, 0.0))
    assert driven.path.pose(driven.length).psi == pytest.approx(turn * math.pi, abs=1e-3)


def test_road_heights_and_friction_of_the_file_are_where_the_file_says(tmp_path: Path) -> None:
    """A straight with 5 % of grade and a bank of 2 %, wider on the left, slippery in its second half."""
    x = np.arange(0.0, 101.0)
    columns = np.stack([x, 0 * x, 0.05 * x, 0 * x + 0.02, 0 * x + 6.0, 0 * x + 3.0, np.where(x < 50, 0.8, 0.3)], axis=1)
    driven = course(tmp_path, csv(columns, "x,y,z,bank,left_width,right_width,friction"))
    assert driven.road_half_width == pytest.approx(np.tile([6.0, 3.0], (len(driven.centreline), 1)))
    assert driven.relief is not None
    assert driven.friction is not None
    begin = driven.reference[0]  # of the file's x in W
    places = begin + np.array([10.0, 40.0]), np.array([2.0, -2.0])
    assert driven.relief.height(*places) == pytest.approx([0.5 + 0.04, 2.0 - 0.04], abs=1e-6)
    assert driven.relief.gradient(*places) == pytest.approx(np.array([[0.05, 0.02]] * 2), abs=1e-6)
    assert driven.friction.at(*places) == pytest.approx(0.8)
    assert driven.friction.at(begin + np.array([60.0]), np.zeros(1)) == pytest.approx(0.3)
    assert course(tmp_path, csv(columns[:, :3], "x,y,z"), "course.heights=false").relief is None


def test_a_rover_follows_a_path_in_its_own_scale(tmp_path: Path) -> None:
    """An arc of 2 m as points every 10 cm: the path starts at the origin along x, with the arc's radius."""
    (tmp_path / "arc.csv").write_text(csv(bend(2.0, spacing=0.1)), encoding="utf-8")
    path = RoverPathOptions(kind="path", file=str(tmp_path / "arc.csv")).path()
    assert path.start == (0.0, 0.0, 0.0)
    assert path.curvature(33.0) == pytest.approx(0.5, rel=1e-2)


def test_a_study_notices_a_changed_path(tmp_path: Path) -> None:
    file = tmp_path / "path.csv"
    file.write_text(csv(bend()), encoding="utf-8")
    scenario = load_scenario("roundabout", settings(file)).model_dump()
    before = content(scenario)
    file.write_text(csv(bend(13.0)), encoding="utf-8")
    assert content(scenario) != before


def test_poses_are_those_of_pose() -> None:
    path = DrivenPath(Pose2(1.0, 2.0, 0.3), (line(5.0), Segment(4.0, 0.0, 0.1), arc(20.0, 0.1)))
    stations = np.array([-3.0, 0.0, 4.9, 5.0, 7.0, 20.0, 29.0, 33.0])
    assert path.poses(stations) == pytest.approx(np.array([path.pose(s) for s in stations.tolist()]), abs=1e-12)


def shifted(points: FloatArray) -> FloatArray:
    return np.where(np.arange(len(points))[:, None] > 40, points + np.array([300.0, 0.0]), points)


def climbing(points: FloatArray, rise: float) -> FloatArray:
    return np.column_stack([points, rise * np.arange(len(points))])


def with_column(*values: float) -> FloatArray:
    return np.column_stack([bend(), np.tile(values, (len(bend()), 1))])


def line_of(coordinates: str) -> str:
    return f'{{"type": "LineString", "coordinates": {coordinates}}}'


REFUSED = {
    "empty": ("path.csv", "", "column 'x' is missing"),
    "no points": ("path.csv", "x,y\n", "has 0 points"),
    "one place": ("path.csv", "x,y\n" + "1,2\n" * 50, "is 0 m long"),
    "not a number": ("path.csv", "x,y\n1,2\nnan,3\n", "line 3: x = 'nan' is not a finite number"),
    "short line": ("path.csv", "x,y\n1,2\n3\n", "line 3 has 1 values for 2 columns"),
    "kilometres": ("path.csv", csv(1e-3 * bend()), "must be 10 m to 50 km"),
    "degrees in CSV": ("path.csv", csv(on_earth(bend())), "columns lat and lon, GPX and GeoJSON have degrees"),
    "a gap": ("path.csv", csv(shifted(bend())), "a gap of 300"),
    "a gap in a bend": ("path.csv", csv(np.delete(bend(), slice(40, 62), axis=0)), "m"),
    "sharp corner": ("path.csv", csv(np.array([[0, 0], [20, 0], [40, 0], [40, 20], [40, 40.0]])), "bows 3"),
    "way back": ("path.csv", csv(np.concatenate([bend()[:30], bend()[20:29][::-1]])), "turns back by 180 deg"),
    "too tight": ("path.csv", csv(bend(4.0)), "has a radius of [34].. m: the tractor would have to steer by"),
    "too narrow": ("path.csv", csv(with_column(0.5, 0.5), "x,y,left_width,right_width"), "the road is 1.00 m wide"),
    "one width": ("path.csv", csv(with_column(4.0), "x,y,left_width"), "give left_width and right_width, or neither"),
    "friction of a percent": ("path.csv", csv(with_column(80.0), "x,y,friction"), "friction = 80 must be within"),
    "no friction": ("path.csv", csv(with_column(0.0), "x,y,friction"), "friction = 0 must be at least 0.05"),
    "bank in degrees": ("path.csv", csv(with_column(3.0), "x,y,bank"), "bank = 3 must be within"),
    "wall": ("path.csv", csv(climbing(bend(), 0.5), "x,y,z"), "slope = 0.5"),
    "bridge": ("path.csv", csv(climbing(bend(20.0, 1.6 * math.pi), 0.02), "x,y,z"), "crosses itself"),
    "unknown ending": ("path.txt", csv(bend()), "must end with .csv, .gpx, .geojson, .json or .crg"),
    "other XML": ("path.gpx", "<kml></kml>", "outermost element is <kml>"),
    "other file": ("path.gpx", '<!DOCTYPE gpx SYSTEM "file:///etc/passwd"><gpx/>', "document type"),
    "waypoints": ("path.gpx", '<gpx><wpt lat="1" lon="2"/></gpx>', "has 0 tracks, 0 routes and 1 waypoints"),
    "deep XML": ("path.gpx", "<a>" * 5000, "nested at most 32 deep"),
    "unknown encoding": ("path.gpx", '<?xml version="1.0" encoding="klingon"?><gpx/>', "unknown encoding"),
    "no latitude": ("path.gpx", gpx(bend()).replace("lat=", "lot=", 2), "a point has no attribute 'lat'"),
    "latitude of 152": ("path.gpx", gpx(bend()).replace('lat="5', 'lat="15'), "must be within -90 to 90 deg"),
    "some heights": ("path.gpx", gpx(bend()).replace("/>", "><ele>3</ele></trkpt>", 5), "5 of .* points have a height"),
    "no JSON": ("path.geojson", "x,y", "not JSON"),
    "deep JSON": ("path.geojson", "[" * 100_000, "nested at most"),
    "a point": ("path.geojson", '{"type": "Point", "coordinates": [1, 2]}', "has no line .*; it has 1 Point"),
    "metres in GeoJSON": ("path.geojson", line_of("[[500000, 1], [2, 3]]"), "longitude = 500000"),
    "NaN in GeoJSON": ("path.geojson", line_of("[[NaN, 1], [2, 3]]"), "not a finite number"),
    "texts": ("path.geojson", line_of('["ab", "cd"]'), "must be a list of longitude"),
    "thousands of digits": ("path.geojson", line_of(f"[[{'9' * 5000}, 1]]"), "not JSON"),
    "round the world": ("path.geojson", line_of("[[0, 1], [20, 30]]"), "must be 10 m to 50 km"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_a_file_that_makes_no_course_is_refused_in_one_line(tmp_path: Path, case: str) -> None:
    name, text, wanted = REFUSED[case]
    with pytest.raises(ValueError, match=r"^[^\n]{1,500}$") as refusal:
        course(tmp_path, text, name=name)
    assert name in str(refusal.value)
    assert refusal.match(wanted)
