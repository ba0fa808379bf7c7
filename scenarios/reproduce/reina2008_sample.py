"""Fig. 6 and Table II of Reina 2008: the stages of FTrace on one image, and its confidence in every candidate.

Reina 2008: G. Reina, G. Ishigami, K. Nagatani, K. Yoshida, "Vision-based estimation of slip angle for mobile robots
and planetary rovers", ICRA 2008.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from estimators.slip.wheel_trace.ftrace import CANDIDATES, Explanation, FTrace
from scenarios.progress import Progress
from scenarios.report.plots import ESTIMATED, GREY, TRUE
from scenarios.reproduce.figure import Reproduction, compared
from scenarios.results.log import Log, Signal
from sensors.sand.rig import nominal_rig
from sensors.sand.sequence import labelled_sequence
from vehicle.frames import FloatArray
from vehicle.rover.description import load_rover

PUBLISHED: Final = (2.1, 1.1, 70.4, 81.7, 24.3, 75.4, 87.0, 10.3, 18.7, 20.2)  # Table II, L1 to L10 [%]
_SOURCE: Final = "Reina et al., ICRA 2008"
_KIND, _SEED = "uniform", 1  # a clearly defined imprint without slip, as in Fig. 6
_FRAME: Final = 30  # number of the image that is shown; FTrace needs the poses of earlier ones
_NOTES: Final = (
    "A simulated image replaces the paper's. Only the distribution of the confidences is comparable; they are sorted.",
    "A candidate is the midline between two edges that may be the walls of a rut. The paper does not say how it finds "
    "the centre line from edges, and does not publish the breakpoints of the membership functions.",
)


def table2(quick: bool, progress: Progress) -> Reproduction:
    """Confidences of the candidates in one image."""
    explanation, ground = _explained(quick, progress)
    own = np.full(CANDIDATES, math.nan)
    own[: len(explanation.confidences)] = 100.0 * np.sort(explanation.confidences)[::-1]
    published = np.sort(PUBLISHED)[::-1]
    return Reproduction(
        name="reina2008-table2",
        title="Table II: confidence match of the candidates in one image, best first",
        source=_SOURCE,
        comparisons=[
            compared(f"candidate {k + 1}", f"{published[k]:.1f}", float(own[k]), "%") for k in range(CANDIDATES)
        ],
        notes=_NOTES,
        data=_data(explanation, ground),
        draw=lambda: _ranking(published, own),
    )


def fig6(quick: bool, progress: Progress) -> Reproduction:
    """Stages from an image to the trace."""
    explanation, ground = _explained(quick, progress)
    best = 100.0 * float(explanation.confidences.max(initial=0.0))
    d, theta, offset = ground[explanation.best].tolist() if explanation.best is not None else (math.nan,) * 3
    return Reproduction(
        name="reina2008-fig6",
        title="Fig. 6: FTrace on one image",
        source=_SOURCE,
        comparisons=[
            compared("candidates", "10", len(explanation.confidences), "-"),
            compared("confidence of the trace", "87", best, "%"),
            compared("angle of the trace", "0 (no slip)", math.degrees(theta), "deg"),
            compared("distance of the trace from G", "", d, "m"),
            compared("distance of the trace from the wheel's centre", "", offset, "m"),
        ],
        notes=_NOTES,
        data=_data(explanation, ground),
        draw=lambda: _panels(explanation, ground),
    )


def _explained(quick: bool, progress: Progress) -> tuple[Explanation, FloatArray]:
    """Explanation of the sample image by FTrace, and d [m], theta [rad] and Y [m] of the candidates."""
    frames = _FRAME // 3 if quick else _FRAME
    rover = load_rover("el_dorado_ii")
    ftrace = FTrace(nominal_rig(rover))
    memory = ftrace.init()
    before = memory
    for k, (view, _, _) in enumerate(
        labelled_sequence(_KIND, seed=_SEED, frames=frames, rover=rover, profile="none", bare=0.0)
    ):
        progress(k, frames, f"image {k + 1}")
        before, last = memory, view
        memory, _ = ftrace.step(memory, view)
    progress(frames, frames, "")
    explanation = ftrace.explain(before, last)
    return explanation, explanation.candidates.ground


def _data(explanation: Explanation, ground: FloatArray) -> Log:
    signals = (
        Signal("rho", "px", "distance of the candidate from the first pixel"),
        Signal("phi", "rad", "direction of the candidate's normal in the image"),
        Signal("d", "m", "distance on the ground from R's origin, + left"),
        Signal("theta", "rad", "direction on the ground, + left"),
        Signal("Y", "m", "lateral offset from the wheel's centre, + left"),
        Signal("votes", "-", "edge pixels on both edges"),
        Signal("confidence", "-", "confidence that the candidate is the trace"),
    )
    columns = (explanation.candidates.image, ground, explanation.candidates.votes, explanation.confidences)
    return Log(signals, np.column_stack(columns))


def _ranking(published: FloatArray, own: FloatArray) -> Figure:
    figure = Figure(figsize=(9.6, 3.2), layout="constrained")
    ax = figure.subplots()
    x = np.arange(1, CANDIDATES + 1)
    ax.bar(x - 0.2, published, 0.38, color=GREY, label="published, sorted")
    ax.bar(x + 0.2, own, 0.38, color=ESTIMATED, label="own, sorted")
    ax.set(xlabel="candidate", ylabel="confidence match [%]")
    ax.set_xticks(x)
    ax.legend()
    return figure


def _panels(explanation: Explanation, ground: FloatArray) -> Figure:
    """Draw (a) image, (b) edges, (c) candidates, (d) trace."""
    figure = Figure(figsize=(9.6, 7.6), layout="constrained")
    axes = figure.subplots(2, 2).ravel()
    titles = ("(a) original scene", "(b) Canny's edges", "(c) candidates", "(d) trace")
    for ax, title, picture in zip(
        axes, titles, (explanation.image, explanation.edges, explanation.image, explanation.image), strict=True
    ):
        ax.imshow(picture, cmap="gray", vmin=0, vmax=255, interpolation="antialiased")
        ax.set(title=title, xticks=[], yticks=[], xlim=(0, picture.shape[1] - 1), ylim=(picture.shape[0] - 1, 0))
    for k, (line, certain) in enumerate(zip(explanation.candidates.image, explanation.confidences, strict=True)):
        _line(axes[2], line, ESTIMATED, 1.0)
        position = _at_row(line, 20.0 + 42.0 * k)
        axes[2].text(*position, f"{100.0 * certain:.0f} %", color="white", fontsize=8, clip_on=True)
    if explanation.best is not None:
        for edge in explanation.candidates.edges[explanation.best]:
            _line(axes[3], edge, TRUE, 1.0)
        _line(axes[3], explanation.candidates.image[explanation.best], ESTIMATED, 2.5)
        d, theta, _ = ground[explanation.best].tolist()
        text = f"$d_t$ = {d:.3f} m, $\\theta_t$ = {math.degrees(theta):.1f}°"
        axes[3].text(12.0, 30.0, text, color="white", fontsize=11)
    return figure


def _line(ax: Axes, line: FloatArray, colour: str, width: float) -> None:
    (u0, v0), (u1, v1) = _at_row(line, 0.0), _at_row(line, 479.0)
    ax.plot([u0, u1], [v0, v1], color=colour, linewidth=width)


def _at_row(line: FloatArray, v: float) -> tuple[float, float]:
    """Point where a line crosses an image row [px]."""
    rho, phi = float(line[0]), float(line[1])
    return (rho - v * math.sin(phi)) / math.cos(phi), v
