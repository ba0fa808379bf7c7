"""Run a scenario of any kind of vehicle from start to finish."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, closing
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final, TypedDict, Unpack, overload

from scenarios.assembly.rover_run import assemble_rover, rover_path
from scenarios.assembly.trailer_run import assemble, course_duration, rendered_images
from scenarios.image_file import PictureSize
from scenarios.loop.bench import Bench
from scenarios.loop.channel import Pacer
from scenarios.loop.image_observers import Recorder
from scenarios.loop.rover_session import RoverSession
from scenarios.loop.session import RunSession
from scenarios.loop.trailer_session import TrailerSession
from scenarios.options.scenario import AnyScenario, RoverScenario, Scenario
from scenarios.processes import check_memory
from scenarios.progress import Progress, no_progress
from scenarios.results.rover_result import RoverResult
from scenarios.results.run_inputs import run_inputs
from scenarios.results.run_summary import Result
from scenarios.results.trailer_result import RunResult

Watch = Callable[[Callable[[], Result]], None]  # takes the result so far from what it is given
Record = Callable[[Any], AbstractContextManager[Recorder[Any, Any]]]  # opens a recording of the assembled parts


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """A kind of vehicle in the loop."""

    assemble: Callable[..., Any]  # of scenario, seed, keep_colour, record and progress; the parts of a run
    session: Callable[..., RunSession[Any, Any, Any]]  # of the parts, keep_frames and recorder
    # A trailer's session also takes a renderer, the thread that renders its cameras, bench and is_paced.
    # A rover's camera sees the sand that the wheels have just shaped, so the loop renders it.
    is_trailer: bool
    images: Callable[[Any], type | None]  # class of the images that a scenario's sensor renders; None: no camera
    duration: Callable[[Any], float]  # of a scenario's course at set speed [s]


KINDS: Final[Mapping[str, Kind]] = {
    "trailer": Kind(
        assemble=assemble,
        session=TrailerSession,
        is_trailer=True,
        images=rendered_images,
        duration=course_duration,
    ),
    "rover": Kind(
        assemble=assemble_rover,
        session=RoverSession,
        is_trailer=False,
        images=lambda scenario: None,  # of sand, which needs no OpenGL
        duration=lambda scenario: rover_path(scenario).length / scenario.speed,
    ),
}  # by the ``vehicle_kind`` of a scenario


class RunOptions(TypedDict, total=False):
    """Options of a run: the keyword arguments of :func:`run`."""

    keep_frames: PictureSize | bool
    record: Record | None
    progress: Progress
    calibration_progress: Progress
    pacer: Pacer | None
    bench: Bench | None
    watch: Sequence[Watch]


@overload
def run(scenario: Scenario, seed: int, **options: Unpack[RunOptions]) -> RunResult: ...
@overload
def run(scenario: RoverScenario, seed: int, **options: Unpack[RunOptions]) -> RoverResult: ...
def run(
    scenario: AnyScenario,
    seed: int,
    *,
    keep_frames: PictureSize | bool = False,
    record: Record | None = None,
    progress: Progress = no_progress,
    calibration_progress: Progress = no_progress,
    pacer: Pacer | None = None,
    bench: Bench | None = None,
    watch: Sequence[Watch] = (),
) -> Result:
    """Run a scenario in the closed loop; an interrupt or an exception ends it early; results so far are kept.

    Args:
        scenario: the scenario.
        seed: decides world and noise; the same seed on the same machine gives bitwise the same log and images.
        keep_frames: keep pictures of the camera for the video and the report, as captured or of this size.
        record: opens a recording of the camera's images.
        progress: receives the completed share of the course.
        calibration_progress: receives the number of finished pictures of calibration boards, and their total.
        pacer: keeps the run to wall time.
        bench: gets the signals and steers what ``outside.demands`` says.
        watch: are called between two steps with a function that makes the result so far.

    Raises:
        ValueError: one line, if the scenario is not consistent.
        RendererUnavailableError: one line, if cameras are needed and OpenGL does not work here.
    """
    check_memory()
    kind, inputs = KINDS[scenario.vehicle_kind], run_inputs(scenario.model_dump(exclude_none=True))
    if bench is not None and not kind.is_trailer:
        raise ValueError(f"--{bench.links[0].name}: signals and demands are those of trailers; a rover has none")
    renderer: Executor | None = None
    with ExitStack() as cleanup:
        opened = partial(kind.assemble, scenario, seed, keep_colour=bool(keep_frames), record=record is not None)
        if kind.images(scenario) is None:
            parts = cleanup.enter_context(closing(opened(progress=calibration_progress)))
        else:  # OpenGL's objects belong to the thread that made them
            renderer = cleanup.enter_context(ThreadPoolExecutor(max_workers=1, thread_name_prefix="renderer"))
            parts = renderer.submit(opened, progress=calibration_progress).result()
            cleanup.callback(renderer.submit, parts.close)
        recorder = cleanup.enter_context(record(parts)) if record else None
        own = {"renderer": renderer, "bench": bench, "is_paced": pacer is not None} if kind.is_trailer else {}
        session = cleanup.enter_context(kind.session(parts, keep_frames=keep_frames, recorder=recorder, **own))
        progress = _watched(progress, watch, partial(session.result, inputs, complete=False))
        if pacer is None:
            session.run(progress)
        else:
            session.run_paced(pacer, progress)
        if recorder:
            recorder.end()
        result = session.result(inputs)
        return result if pacer is None else replace(result, paced=pacer.report())


def _watched(progress: Progress, watch: Sequence[Watch], result: Callable[[], Result]) -> Progress:
    """The progress callback, which asks those who watch too."""
    if not watch:
        return progress

    def both(done: float, total: float, note: str = "", /) -> None:
        for one in watch:
            one(result)
        progress(done, total, note)

    return both
