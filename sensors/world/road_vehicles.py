"""Other road vehicles: a lorry and a car, with their textures.

Origin of each: its middle on the ground, x forward. Sizes are those of real vehicles [m]. Not modelled: wheels that
turn or steer, the view through windows, reflections.
"""

from __future__ import annotations

import numpy as np

from sensors.textures import NoiseArray, TextureArray, fractal_noise, to_bytes
from sensors.world.shapes import Mesh, box, joined, pole, polygon
from sensors.world.things import Colour, Part, Thing
from vehicle.frames import FloatArray

PAINT, LIVERY = "paint", "livery"
LORRY_AXLES, CAR_AXLES = (3.7, -3.0), (1.35, -1.3)  # front and rear, ahead of the middle [m]
_GLASS: Colour = (0.16, 0.19, 0.22)
_RUBBER: Colour = (0.10, 0.10, 0.11)
_STEEL: Colour = (0.34, 0.35, 0.37)
_COLOURS: tuple[Colour, ...] = (
    (0.86, 0.86, 0.84),
    (0.62, 0.12, 0.10),
    (0.13, 0.24, 0.48),
    (0.20, 0.22, 0.24),
    (0.78, 0.62, 0.12),
    (0.22, 0.42, 0.28),
)


def lorry(rng: np.random.Generator) -> Thing:
    """A rigid lorry, 10 m long, with a box body and a cab 3.9 m high."""
    cab = [(5.1, 0.45), (5.15, 1.5), (4.9, 3.0), (4.7, 3.6), (4.3, 3.85), (3.0, 3.88), (3.0, 0.45)]
    screen = np.array([[5.16, -1.05, 1.65], [5.16, 1.05, 1.65], [4.95, 1.05, 2.75], [4.95, -1.05, 2.75]])
    side = np.array([[4.85, 0.0, 1.7], [3.6, 0.0, 1.7], [3.6, 0.0, 2.6], [4.75, 0.0, 2.6]])
    body = box((-5.0, 2.85), (-1.275, 1.275), (0.95, 3.9), texture_size=3.0)
    frame = box((-4.9, 3.0), (-0.5, 0.5), (0.55, 0.95), texture_size=1.0)
    bumper = box((5.0, 5.22), (-1.2, 1.2), (0.35, 0.85), texture_size=0.8)
    grille = [box((5.1, 5.19), (-0.8, 0.8), (z, z + 0.07), texture_size=0.8) for z in (0.95, 1.12, 1.29)]
    lights = [box((5.2, 5.25), (y - 0.16, y + 0.16), (0.5, 0.72), texture_size=1.0) for y in (-0.95, 0.95)]
    mirrors = [box((4.9, 5.05), (y - 0.1, y + 0.1), (1.8, 2.6), texture_size=1.0) for y in (-1.42, 1.42)]
    wheels = [_wheel(x, y, 0.5, 0.33) for x in LORRY_AXLES for y in (-1.05, 1.05)]
    panes = [_outward(screen, np.zeros(3)), *(_side_pane(side, y) for y in (-1.262, 1.262))]
    return Thing(
        name="lorry",
        parts=(
            Part(mesh=_extruded(cab, 1.25), texture=PAINT, colour=_random_colour(rng)),
            Part(mesh=body, texture=LIVERY, colour=_random_colour(rng)),
            Part(mesh=joined(*panes), texture=PAINT, colour=_GLASS),
            Part(mesh=joined(frame, bumper, *grille, *mirrors, *wheels), texture=PAINT, colour=_RUBBER),
            Part(mesh=joined(*lights), texture=PAINT, colour=(1.2, 1.2, 1.1)),
        ),
        variety=0.0,
    )


def car(rng: np.random.Generator) -> Thing:
    """A saloon car, 4.4 m long."""
    lower = [(2.15, 0.28), (2.2, 0.62), (1.15, 0.92), (-2.05, 0.98), (-2.2, 0.75), (-2.15, 0.28)]
    upper = [(1.15, 0.9), (0.4, 1.4), (-0.9, 1.44), (-1.75, 0.96)]
    screen = np.array([[1.1, -0.62, 0.96], [1.1, 0.62, 0.96], [0.46, 0.58, 1.38], [0.46, -0.58, 1.38]])
    rear = np.array([[-1.72, -0.6, 1.0], [-1.72, 0.6, 1.0], [-0.98, 0.58, 1.41], [-0.98, -0.58, 1.41]])
    side = np.array([[0.9, 0.0, 0.98], [-1.45, 0.0, 1.0], [-0.9, 0.0, 1.36], [0.4, 0.0, 1.34]])
    lights = [box((2.1, 2.2), (y - 0.18, y + 0.18), (0.55, 0.7), texture_size=1.0) for y in (-0.62, 0.62)]
    plate = box((2.17, 2.22), (-0.26, 0.26), (0.36, 0.48), texture_size=1.0)
    wheels = [_wheel(x, y, 0.32, 0.2) for x in CAR_AXLES for y in (-0.78, 0.78)]
    inside = np.array([0.0, 0.0, 0.8])
    panes = [_lifted(screen, inside), _lifted(rear, inside), *(_side_pane(side, y) for y in (-0.735, 0.735))]
    colour = _random_colour(rng)
    return Thing(
        name="car",
        parts=(
            Part(mesh=joined(_extruded(lower, 0.88), _extruded(upper, 0.72)), texture=PAINT, colour=colour),
            Part(mesh=joined(*panes), texture=PAINT, colour=_GLASS),
            Part(mesh=joined(*wheels), texture=PAINT, colour=_RUBBER),
            Part(mesh=joined(*lights, plate), texture=PAINT, colour=(1.2, 1.2, 1.05)),
        ),
        variety=0.0,
    )


def vehicle_textures(rng: np.random.Generator) -> dict[str, TextureArray]:
    """Textures of the parts: paint with dirt and seams, and the lettering of a box body."""
    return {PAINT: _paint(rng), LIVERY: _livery(rng)}


def _random_colour(rng: np.random.Generator) -> Colour:
    return _COLOURS[int(rng.integers(len(_COLOURS)))]


def _paint(rng: np.random.Generator, size: int = 256) -> TextureArray:
    """Nearly uniform paint with streaks of dirt and two seams per repeat."""
    streaks = fractal_noise(rng, (size, size), 1.0, (0.0, 0.1))
    grain = fractal_noise(rng, (size, size), 0.3, (0.05, 0.4))
    level = np.asarray(0.88 + 0.05 * streaks + 0.02 * grain, dtype=np.float32)
    level[size // 2 : size // 2 + 3] *= 0.55
    level[:, size // 3 : size // 3 + 3] *= 0.55
    return _grey(level)


def _livery(rng: np.random.Generator, size: int = 512) -> TextureArray:
    """A broad band with letter-like blocks on painted sheets with rows of rivets; one repeat is 3 m."""
    level = np.full((size, size), 0.9, dtype=np.float32)
    level[size // 3 : 2 * size // 3] = 0.35
    u = 10
    while u < size - 50:
        width, height = int(rng.integers(14, 44)), int(rng.integers(60, 130))
        level[size // 2 - height // 2 : size // 2 + height // 2, u : u + width] = rng.uniform(0.75, 1.0)
        u += width + int(rng.integers(8, 22))
    level[:, :: size // 6] *= 0.7
    level += 0.04 * fractal_noise(rng, (size, size), 0.8, (0.0, 0.3))
    return _grey(level)


def _grey(level: NoiseArray) -> TextureArray:
    return to_bytes(np.repeat(level[..., None], 3, axis=-1))


def _outward(corners: FloatArray, centre: FloatArray, *, texture_size: float = 1.5, shade: float = 1.0) -> Mesh:
    """A flat polygon that faces away from the ``centre`` (3,)."""
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    ordered = corners if normal @ (corners.mean(axis=0) - centre) > 0.0 else corners[::-1]
    return polygon(ordered, texture_size=texture_size, shade=shade)


def _lifted(corners: FloatArray, centre: FloatArray) -> Mesh:
    """A polygon as of ``_outward``, 3 cm above the sheet it lies on."""
    pane = _outward(corners, centre)
    return pane.moved(by=tuple((0.03 * pane.normals[0]).tolist()))


def _side_pane(corners: FloatArray, y: float) -> Mesh:
    """A pane (n, 3), given in the xz plane, on the vehicle's side at y."""
    return _outward(corners + np.array([0.0, y, 0.0]), corners.mean(axis=0))


def _extruded(profile: list[tuple[float, float]], half_width: float) -> Mesh:
    """A convex outline (x, z) extruded across the vehicle; darker towards its underside."""
    outline = np.array([(x, 0.0, z) for x, z in profile])
    centre, across = outline.mean(axis=0), np.array([0.0, half_width, 0.0])
    faces = []
    for k, end in enumerate(outline):
        start = outline[k - 1]
        shade = 0.3 if max(start[2], end[2]) < 0.5 else 1.0
        faces.append(
            _outward(np.array([start - across, end - across, end + across, start + across]), centre, shade=shade)
        )
    sides = [_outward(outline + side * across, centre) for side in (-1.0, 1.0)]
    return joined(*faces, *sides)


def _wheel(x: float, y: float, radius: float, width: float) -> Mesh:
    """A wheel about an axle across the vehicle."""
    tread = pole((radius, -0.5 * width), (radius, 0.5 * width), sides=14)
    turned = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # its axis from z to y
    middle = np.array([x, y, radius])
    tyre = Mesh(
        vertices=tread.vertices @ turned.T + middle,
        normals=tread.normals @ turned.T,
        uv=tread.uv,
        shade=0.5 * tread.shade,
        faces=tread.faces,
    )
    angle = np.linspace(0.0, 2.0 * np.pi, 15)[:-1]
    rim = np.column_stack([radius * np.cos(angle), np.zeros(14), radius * np.sin(angle)]) + middle
    sides = [_outward(rim + np.array([0.0, side * 0.5 * width, 0.0]), middle) for side in (-1.0, 1.0)]
    hubs = [
        _outward(middle + 0.5 * (rim - middle) + [0.0, side * (0.5 * width + 0.01), 0.0], middle) for side in (-1, 1)
    ]
    return joined(tyre, *sides, *hubs)
