"""Imprint of a wheel in sand: depth, width, berms and lug marks follow from its motion."""

import math
from typing import Any

import cv2
import numpy as np
import pytest

from sensors.sand.field import Field, Reach, around, decoded, encoded, sunlit
from sensors.sand.grid import TEXEL, Floats, Tread, Window, slumped
from sensors.sand.relief import ALBEDO, Relief, SandKind
from sensors.sand.world import Stand, Wheel
from sensors.world.sky import daylight
from vehicle.engine.compiler import compiler, kernel
from vehicle.rover.terrain import Terrain

TREAD = Tread(radius=0.102, width=0.100, lugs=20, lug_height=0.005)
SUN = daylight(0.6, elevation=math.radians(35.0))
AROUND = Window(-150, 0, 150, 600)  # of the wheel's path along x [texels]
MIDDLE = slice(200, 400)  # columns far from both ends of the path
SINKAGE = 0.012  # [m]


@pytest.fixture(scope="module")
def relief() -> Relief:
    """Level sand with a roughness of 0.3 mm and nothing else."""
    smooth = SandKind(ripples=0.0, low_relief=0.0, stones=0.0, blotches=0.0)
    return Relief.draw(np.random.default_rng(1), smooth, Terrain(), 0.0)


def field_of(relief: Relief) -> Field:
    return Field(relief=relief, sun=SUN, tracks=(), rocks=(), reach=Reach.of(SUN))


def roll(
    field: Field,
    *,
    slip_angle: float = 0.0,
    slip: float = 0.0,
    sinkage: float = SINKAGE,
    y: float = 0.0,
    watched: bool = False,
) -> None:
    """Roll a wheel 0.6 m along x; ``watched``: update the light after each step. Side slip turns its heading off x."""
    wheel = Wheel(TREAD)
    for x in np.arange(0.0003, 0.6, 0.016).tolist():  # no end of a path lies on a texel, which rounding would decide
        turned = x * math.cos(slip_angle) / (TREAD.radius * (1.0 - slip))
        wheel.roll_on(field, Stand(np.array([x, y]), 0.0, slip_angle, turned, sinkage))
        if watched:
            field.light(AROUND)


def changed(relief: Relief, **motion: float) -> Floats:
    """Change of the ground's height by a wheel that rolls over it [m]."""
    field = field_of(relief)
    before = field.height(AROUND)
    roll(field, **motion)  # type: ignore[arg-type]  # none of these is ``watched``
    return field.height(AROUND) - before


def width_of(change: Floats, depth: float) -> float:
    """Mean width of the part deeper than a depth, in the middle of the path [m]."""
    return float((change[:, MIDDLE] < -depth).sum(axis=0).mean()) * TEXEL


def lug_marks(change: Floats, across: float) -> Floats:
    """Relief along the rut at a lateral distance ``across`` from its middle, as a mean over 5 mm [m]."""
    row = round(across / TEXEL) - AROUND.top
    marks: Floats = change[row - 2 : row + 3, MIDDLE].mean(axis=0)
    return marks


def spacing_of(marks: Floats) -> float:
    """Shift with the largest autocorrelation of the relief [m]."""
    shifts = range(12, 60)
    correlation = [np.corrcoef(marks[shift:], marks[:-shift])[0, 1] for shift in shifts]
    return shifts[int(np.argmax(correlation))] * TEXEL


@pytest.mark.parametrize("sinkage", [0.006, 0.012, 0.020])
def test_rut_is_as_deep_as_the_wheel_sinks(relief: Relief, sinkage: float) -> None:
    floor = changed(relief, sinkage=sinkage)[140:160, MIDDLE]
    assert -floor.mean() == pytest.approx(sinkage, abs=0.001)  # lugs press 5 mm deeper and pile up as much behind them


def test_rut_lies_on_the_path_of_the_wheel(relief: Relief) -> None:
    """The middle of the rut is the path of the wheel's lowest point, at any slip."""
    for slip_angle in (-0.2, 0.0, 0.2):
        change = changed(relief, slip_angle=slip_angle, y=0.0123)
        rows, _ = np.nonzero(change[:, MIDDLE] < -0.4 * SINKAGE)
        middle = (rows.mean() + AROUND.top) * TEXEL
        assert middle == pytest.approx(0.0123, abs=0.002)  # edges are ragged by that, and the berms lean in


def test_side_slip_widens_the_rut(relief: Relief) -> None:
    """Front and rear of the sunken part sweep flanks: it gains 2 l sin(alpha) and loses b (1 - cos(alpha))."""
    straight, slipping = (width_of(changed(relief, slip_angle=a), 0.25 * SINKAGE) for a in (0.0, 0.3))
    at_depth = math.sqrt(0.75 * SINKAGE * (2.0 * TREAD.radius - 0.75 * SINKAGE))  # half chord above the floor [m]
    swept = 2.0 * at_depth * math.sin(0.3) - TREAD.width * (1.0 - math.cos(0.3))
    assert straight == pytest.approx(TREAD.width, abs=0.008)  # walls slump by half the depth at most to each side
    assert slipping - straight == pytest.approx(swept, rel=0.5)  # walls slump, and round the corners off


def test_berm_is_higher_on_the_side_the_wheel_slides_to(relief: Relief) -> None:
    """A wheel that travels to the left of its heading pushes sand to its left; mirrored, to its right."""
    left, right = (
        np.clip(changed(relief, slip_angle=sign * 0.2)[rows, MIDDLE], 0.0, None).sum()
        for sign, rows in ((1.0, slice(150, 300)), (-1.0, slice(0, 150)))
    )
    lee = np.clip(changed(relief, slip_angle=0.2)[:150, MIDDLE], 0.0, None).sum()
    assert left > 1.5 * lee
    assert right == pytest.approx(left, rel=0.25)  # the same but for the raggedness of either side


@pytest.mark.parametrize("slip", [0.0, 0.15, 0.3])
def test_lug_marks_lie_as_far_apart_as_the_wheel_turns(relief: Relief, slip: float) -> None:
    """Between two marks the wheel turns by one lug and moves 2 pi r (1 - s) / n."""
    marks = lug_marks(changed(relief, slip=slip), 0.0)
    expected = 2.0 * math.pi * TREAD.radius * (1.0 - slip) / TREAD.lugs
    assert spacing_of(marks) == pytest.approx(expected, abs=0.0015)  # a texel, and raggedness


def test_a_spinning_wheel_smears_its_marks(relief: Relief) -> None:
    clear, smeared = (float(lug_marks(changed(relief, slip=slip), 0.0).std()) for slip in (0.0, 0.4))
    assert smeared < 0.6 * clear


@pytest.mark.parametrize("slip_angle", [-0.15, 0.0, 0.15])
def test_lug_marks_lie_across_the_heading_not_across_the_path(relief: Relief, slip_angle: float) -> None:
    """Marks are parallel to the axle: 40 mm farther left they lie 40 mm tan(alpha) farther ahead."""
    change = changed(relief, slip_angle=slip_angle)
    right, left = lug_marks(change, -0.02), lug_marks(change, 0.02)
    shifts = np.arange(-12, 13)
    correlation = [np.corrcoef(right[12:-12], np.roll(left, -shift)[12:-12])[0, 1] for shift in shifts]
    ahead = float(shifts[int(np.argmax(correlation))]) * TEXEL
    assert ahead == pytest.approx(0.04 * math.tan(slip_angle), abs=0.0025)  # raggedness; 0.15 rad would be 6 mm


def test_a_wheel_that_does_not_sink_leaves_nothing(relief: Relief) -> None:
    assert not changed(relief, sinkage=0.0).any()


def test_a_second_wheel_in_the_rut_makes_no_second_berm(relief: Relief) -> None:
    field = field_of(relief)
    before = field.height(AROUND)
    roll(field)
    once = np.clip(field.height(AROUND) - before, 0.0, None)[:, MIDDLE].sum()
    roll(field)
    twice = np.clip(field.height(AROUND) - before, 0.0, None)[:, MIDDLE].sum()
    assert twice < 1.5 * once


def test_a_track_stays_where_another_crosses_it(relief: Relief) -> None:
    field = field_of(relief)
    roll(field)
    first = field.height(AROUND)
    across = Wheel(TREAD)
    for y in np.arange(-0.3, 0.3, 0.016):
        across.roll_on(field, Stand(np.array([0.3, y]), 0.5 * math.pi, 0.0, y / TREAD.radius, SINKAGE))
    second = field.height(AROUND)
    outside = slice(0, 150)  # columns 0.15 m and more before the crossing
    assert np.array_equal(first[:, outside], second[:, outside])
    assert (second[20:80, 290:310].mean() - first[20:80, 290:310].mean()) < -0.8 * SINKAGE


def test_sand_slides_to_its_repose_and_none_is_lost() -> None:
    """A wall slumps to 37 deg; the volume stays."""
    wall = np.zeros((40, 60), np.float32)
    wall[:, 30:] = 0.01
    inside = np.ones(wall.shape, dtype=bool)
    after = slumped(wall, inside, 400)
    assert np.abs(np.diff(after, axis=1)).max() < 0.78 * TEXEL  # repose is 0.75, reached from above
    assert after.sum() == pytest.approx(wall.sum(), rel=1e-5)  # single precision over 2400 texels


def test_level_sand_is_lit_by_the_cosine_of_the_sun() -> None:
    """Lambert: n . s = sin(elevation), and all of the sky."""
    reach = Reach.of(SUN)
    sun, sky = sunlit(np.zeros(around(Window(0, 0, 20, 20), reach.before).shape, np.float32), reach, SUN)
    np.testing.assert_allclose(sun, math.sin(math.radians(35.0)), atol=1e-6)
    np.testing.assert_allclose(sky, 1.0, atol=1e-6)


def test_reflected_light_is_albedo_times_light() -> None:
    """Bytes hold its square root, which is good to 1 %."""
    albedo, packed = np.full((1, 3), round(0.8 * ALBEDO), np.uint8), np.zeros((1, 3), np.uint8)
    sun, sky = np.array([[0.0, 0.4, 0.9]], np.float32), np.array([[1.0, 0.7, 0.5]], np.float32)
    shares = decoded(encoded(albedo, packed, np.full((1, 3), 255, np.uint8), sun, sky))
    np.testing.assert_allclose(shares[..., 0], 0.8 * sun, atol=0.015)
    np.testing.assert_allclose(shares[..., 1], 0.8 * sky, atol=0.015)


@pytest.mark.parametrize(("azimuth", "axis"), [(0.0, 1), (math.pi, 1), (0.5 * math.pi, 0), (-0.5 * math.pi, 0)])
def test_a_wall_throws_a_shadow_of_its_height_over_the_tangent_of_the_sun(azimuth: float, axis: int) -> None:
    """A wall of 10 mm towards the sun shades 10 mm / tan(elevation) of the ground behind it, whatever the direction."""
    light = daylight(azimuth, elevation=math.radians(30.0))
    reach = Reach.of(light)
    whole = around(Window(0, 0, 100, 100), reach.before)
    height = np.zeros(whole.shape, np.float32)
    towards = light.direction[1 - axis] > 0.0
    lit_from = slice(reach.before[axis] + 50, None) if towards else slice(None, reach.before[axis] + 50)
    height[(slice(None), lit_from) if axis else (lit_from, slice(None))] = 0.01
    sun, _ = sunlit(height, reach, light)
    line = sun[50] if axis else sun[:, 50]
    dark = (line[:50] if towards else line[50:]) < 0.25
    assert dark.sum() == pytest.approx(10.0 / math.tan(math.radians(30.0)), abs=2.5)  # [texels], one step of the search


def test_light_is_up_to_date_after_a_wheel(relief: Relief) -> None:
    stepwise, once = field_of(relief), field_of(relief)
    before = stepwise.light(AROUND)
    roll(stepwise, watched=True)
    roll(once)
    after = stepwise.light(AROUND).astype(int)
    assert (after != before).mean() > 0.1
    # Sums of single precision over different windows may round to another byte; a forgotten shadow is 20 and more.
    assert np.abs(after - once.light(AROUND)).max() <= 1


@pytest.mark.parametrize("slip_angle", [-0.2, 0.0])
def test_compiled_and_plain_code_shape_and_light_the_same_sand(
    relief: Relief, monkeypatch: pytest.MonkeyPatch, slip_angle: float
) -> None:
    """Lugs press unequally by digits of a sine that rounding changes: 0.3 % of 3 mm."""
    fields, compiled, has_compiler = [], [], compiler() is not None

    def recorded(*name: Any) -> Any:
        compiled.append(kernel(*name))
        return compiled[-1]

    for module in ("grid", "field", "relief"):
        monkeypatch.setattr(f"sensors.sand.{module}.kernel", recorded)
    for _ in range(2):
        fields.append(field_of(relief))
        roll(fields[-1], slip_angle=slip_angle)
        fields[-1].light(AROUND)
        assert all((found is not None) == has_compiler for found in compiled)  # every source compiles
        compiled.clear()
        has_compiler = False
        monkeypatch.setenv("OFFTRACK_COMPILER", "none")
    one, plain = (field.sand(AROUND) for field in fields)
    assert np.abs(one.height - plain.height).max() < 2e-5  # [m]
    assert np.abs(one.packed.astype(int) - plain.packed).max() <= 1
    difference = cv2.absdiff(*(field.light(AROUND) for field in fields))
    assert np.quantile(difference, 0.99) <= 1.0
    assert difference.mean() < 0.05


def test_rays_towards_any_sun_stay_within_the_margins() -> None:
    """The margins of a window have the ground under its longest ray, on every side."""
    for azimuth, elevation in np.radians(np.random.default_rng(1).uniform((0.0, 25.0), (360.0, 50.0), (500, 2))):
        reach = Reach.of(daylight(float(azimuth), elevation=float(elevation)))
        rows, columns, _ = np.array(reach.rays).T
        assert -reach.before.top <= rows.min()
        assert rows.max() <= reach.before.bottom
        assert -reach.before.left <= columns.min()
        assert columns.max() <= reach.before.right
