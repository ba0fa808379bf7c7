"""Road roughness, averaged as by a tyre: a random field of an ISO 8608 class, and potholes in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vehicle.frames import FloatArray
from vehicle.surface.potholes import Potholes
from vehicle.surface.unevenness import plane_psd

_CELL = 0.1  # nodes of the field: waves down to 0.2 m, as short as a contact patch is long [m]
_NODES = 1024  # along each side of the tile: waves up to 102.4 m, of 0.3 Hz at 120 km/h; a power of two for the FFT
PATCH_SPREAD = 0.2 / np.sqrt(12.0)  # of the contact patch of a truck's tyre, 0.2 m long at its rated load [m]
_SLOPE = 0.5 * (np.sqrt(5.0) - 1.0)  # golden section: the slope whose line takes longest to come close to itself
_ALONG, _ACROSS = np.array([1.0, _SLOPE]) / np.hypot(1.0, _SLOPE) / _CELL  # (cos, sin) of the tile's rotation [nodes/m]
_MASK = _NODES - 1


class RoughProfile:
    """Heights of an isotropic rough road on a rotated periodic tile.

    The tile repeats without a seam. A straight road along x or y crosses it at the golden section, each time along
    another line, so that no track repeats itself: within 1 km it stays at least 4.8 m away from its earlier parts.
    """

    def __init__(self, rng: np.random.Generator, road_class: str) -> None:
        """Draw a road of that class, A to H (ISO 8608, geometric mean)."""
        phase = np.fft.rfft2(rng.standard_normal((_NODES, _NODES), dtype=np.float32))
        phase /= np.abs(phase)  # only phases are random: each road has exactly the unevenness of its class
        tile = np.fft.irfft2(phase * _amplitudes(road_class), s=(_NODES, _NODES)) * _NODES**2
        wrapped = np.pad(tile, ((0, 1), (0, 1)), mode="wrap")
        self._heights: NDArray[np.float32] = wrapped.astype(np.float32).ravel()

    def height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Height above the smooth ground [m] at x, y [m], linear between the nodes."""
        u, v = _ALONG * x + _ACROSS * y, _ALONG * y - _ACROSS * x
        u_node, v_node = np.floor(u), np.floor(v)
        a, b = u - u_node, v - v_node
        first = (v_node.astype(np.intp) & _MASK) * (_NODES + 1) + (u_node.astype(np.intp) & _MASK)
        z = self._heights
        z_0, z_1 = z[first], z[first + (_NODES + 1)]
        lower = z_0 + a * (z[first + 1] - z_0)
        upper = z_1 + a * (z[first + (_NODES + 2)] - z_1)
        height: FloatArray = lower + b * (upper - lower)
        return height


def _amplitudes(road_class: str) -> FloatArray:
    """Amplitude [m] of each wave of the tile, in the order of numpy's rfft2."""
    n_v, n_u = np.fft.fftfreq(_NODES, _CELL)[:, None], np.fft.rfftfreq(_NODES, _CELL)[None, :]  # [cycles/m]
    k = np.hypot(n_v, n_u)
    inside = (k > 0.0) & (k < 0.5 / _CELL)
    step = 1.0 / (_NODES * _CELL)  # between the waves' spatial frequencies [cycles/m]
    amplitude = step * np.sqrt(plane_psd(road_class, np.where(inside, k, 1.0), PATCH_SPREAD))
    # Linear interpolation between the nodes reduces each wave by sinc^2 along u and v.
    return np.asarray(np.where(inside, amplitude / (np.sinc(_CELL * n_u) * np.sinc(_CELL * n_v)) ** 2, 0.0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Roughness:
    """Roughness of a road on top of the smooth ground."""

    profile: RoughProfile | None = None
    potholes: Potholes | None = None

    def height(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Height of the road above the smooth ground [m] at x, y [m], of their common shape."""
        x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        height = self.waves(x, y)
        return height - self.potholes.depth_at(x, y) if self.potholes is not None else height

    def waves(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Height without the potholes [m]."""
        if self.profile is None:
            return np.zeros(np.broadcast_shapes(np.shape(x), np.shape(y)))
        return self.profile.height(x, y)
