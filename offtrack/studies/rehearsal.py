"""What is done before the first run of a study: its runs are assembled, and some are driven for a moment.

A law without its network, a missing file or a vehicle that can't be steered so is refused before anything is written.
"""

import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from typing import Any, Final

from estimators.off_tracking.viso_ot import VisoOt
from offtrack.studies.case import Case
from scenarios.loop.channel import InLine
from scenarios.loop.runner import KINDS
from scenarios.options.scenario import AnyScenario
from scenarios.progress import Progress
from sensors.render import RendererUnavailableError
from vehicle.clock import TICK

_WITHOUT_CAMERAS: Final = {"off_tracking": "truth", "viso_ot": VisoOt.Parameters(), "estimator": {}, "sensor": None}
_BEGIN, _DRIVEN = 0.3, 0.5  # of a run that is timed: simulated time that does not count, and wall time after it [s]
_TIMED: Final = 4  # at most so many runs are timed
_MANY: Final = 8  # fewer runs are not timed


def without_cameras(scenario: AnyScenario) -> AnyScenario:
    """A trailer's scenario whose assembly renders nothing, for checks of all other parts."""
    return scenario.model_copy(update=_WITHOUT_CAMERAS)


def rehearse(cases: Sequence[Case], progress: Progress, *, elsewhere: bool, runs: int | None = None) -> float | None:
    """Assemble each point of the grid with its first seed and draw; return the time of all runs, one by one [s].

    The time is None if it is not known, as of few runs.

    Cameras take seconds to open: of points that differ in numbers alone, the first has them.

    Args:
        cases: the runs that are to be made.
        progress: receives a note meanwhile.
        elsewhere: other machines make the runs, so that this one needs no OpenGL.
        runs: number of runs, if it is another than that of the cases.

    Raises:
        ValueError: one line, for the first run that is not consistent.
        RendererUnavailableError: one line, if cameras are needed here and OpenGL does not work.
    """
    first: dict[Any, Case] = {}
    for case in cases:
        first.setdefault(case.axes, case)
    seen, times, runs = set[tuple[str, ...]](), list[float](), runs or len(cases)
    for k, case in enumerate(first.values()):
        progress(0, len(cases), f"checked {k} of {len(first)}")
        words = tuple(value for _, value in case.axes if not _is_number(value))
        scenario = case.resolved()
        kind = KINDS[scenario.vehicle_kind]
        if kind.images(scenario) is not None:
            exact = scenario.rig.model_copy(update={"calibration": "exact"})  # boards take a minute
            whole = scenario.model_copy(update={"rig": exact})
            scenario = whole if words not in seen else without_cameras(scenario).model_copy(update={"faults": ()})
        try:
            with closing(kind.assemble(scenario, case.seed)) as parts:
                if words not in seen and len(times) < _TIMED and runs >= _MANY:
                    times.extend(_timed(kind.session(parts, worker=InLine()), kind.duration(scenario)))
        except RendererUnavailableError:
            if not elsewhere:
                raise
        seen.add(words)
    return runs * sum(times) / len(times) if times else None


def _timed(session: Any, duration: float) -> Iterator[float]:
    """Time that a run takes, by its first moments [s]; none if it ends in them."""
    begin = since = time.perf_counter()
    start = None
    with closing(session):
        while session.outcome is None:
            session.advance()
            now = time.perf_counter()
            if start is None and session.tick * TICK >= _BEGIN:
                since, start = now, session.tick
            elif start is not None and now - since >= _DRIVEN:
                simulated = (session.tick - start) * TICK
                yield since - begin + duration * (now - since) / simulated
                return


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def time_text(seconds: float) -> str:
    """A time that is known roughly."""
    units = ((90.0, 1.0, "s"), (5400.0, 60.0, "min"), (172_800.0, 3600.0, "h"), (float("inf"), 86_400.0, "days"))
    unit, name = next((unit, name) for below, unit, name in units if seconds < below)
    return f"{max(1.0, seconds / unit):.0f} {name}"
