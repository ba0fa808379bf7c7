"""Checks of a trailer whose hitch enters a circle along a tangent, against the closed form."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from scenarios.validation.check import Check, Plot, Section, Series
from scenarios.validation.closed_forms import tractrix_articulation
from scenarios.validation.driving import CREEP, poses_of, round_circle
from scenarios.validation.vehicles import gripping, tractor_and_trailer
from vehicle.combination.description import load_vehicle
from vehicle.frames import FloatArray

_CASES: Final = (  # radius, hitch to axle [m], articulation after 90 and after 180 degrees [deg]
    (12.5, 8.0, 34.785, 39.055),
    (10.0, 8.0, 41.105, 49.744),
    (12.5, 12.0, 46.330, 60.283),
)


def tractrix(quick: bool) -> Section:
    """Trailers whose hitch enters a circle along a tangent."""
    cases = _CASES[:1] if quick else _CASES
    checks: list[Check] = []
    series: list[Series] = []
    for case in cases:
        radius, length, at_90, at_180 = case
        turned, articulation = _driven(radius, length)
        exact = np.array([tractrix_articulation(radius, length, phi) for phi in turned])
        checks += [
            _angle(f"R = {radius:g} m, L = {length:g} m: articulation after 90°", turned, articulation, 90.0, at_90),
            _angle(f"R = {radius:g} m, L = {length:g} m: articulation after 180°", turned, articulation, 180.0, at_180),
            Check(
                f"R = {radius:g} m, L = {length:g} m: largest distance from the closed form",
                math.degrees(float(np.abs(articulation - exact).max())),
                "°",
                target=0.0,
                tolerance=1e-3,
                source="tractrix onto a circle, closed form with the half-angle tangent",
            ),
        ]
        series += [
            Series(f"R = {radius:g} m, L = {length:g} m", np.degrees(turned), np.degrees(articulation), "model"),
            Series("closed form" if case is cases[-1] else "", np.degrees(turned), np.degrees(exact), "reference"),
        ]
    return Section(
        title="Tractrix",
        text="The hitch of a tractor on stiff tyres enters a circle along a tangent. The trailer's articulation is "
        "compared with the closed form for an axle that does not slide sideways.",
        checks=tuple(checks),
        plots=(
            Plot(
                title="Articulation over the turn of the hitch",
                x_label="turn of the hitch's path [°]",
                y_label="articulation [°]",
                series=tuple(series),
            ),
        ),
    )


def _angle(name: str, turned: FloatArray, articulation: FloatArray, at: float, published: float) -> Check:
    return Check(
        name=name,
        value=float(np.interp(at, np.degrees(turned), np.degrees(articulation))),
        target=published,
        tolerance=1.5e-3,  # 1e-3 for the model, plus the rounding of the target
        unit="°",
        source="calculated from the closed form, to three decimals",
    )


def _driven(radius: float, length: float) -> tuple[FloatArray, FloatArray]:
    """Turn of the hitch's path and articulation to it [rad], over half a circle."""
    vehicle = gripping(tractor_and_trailer(load_vehicle("eu_tractor_semitrailer"), length=length, hitch_x=0.0))
    truths = round_circle(vehicle, radius, CREEP, math.pi * radius + 0.1)
    hitch = np.array([now.velocities[1] for now in truths])
    articulation = np.arctan2(hitch[:, 1], hitch[:, 0])
    return poses_of(truths)[:, 1, 2] + articulation, articulation
