"""Gymnasium environments by name, single and vector; ``import offtrack`` registers them.

import gymnasium
import offtrack

env = gymnasium.make("offtrack/TrailerSteering-v0")
many = gymnasium.make_vec("offtrack/TrailerSteering-v0", num_envs=1024)
"""

import copyreg
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final, Literal

import gymnasium as gym
import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from offtrack.environments.core import (
    MAX_ENVS,
    Core,
    EnvironmentOptions,
    Info,
    Lanes,
    Observation,
    Result,
    call_error,
    checked_actions,
    checked_count,
    checked_seed,
    of_lane,
    reset_options,
)
from offtrack.environments.driving import TractorTrailerDriving, TractorTrailerDrivingOptions
from offtrack.environments.rover_options import RoverSteeringOptions
from offtrack.environments.rover_steering import RoverSteering
from offtrack.environments.trailer_steering import TrailerSteering, TrailerSteeringOptions
from offtrack.reports.canvas import Picture
from vehicle.foundation.user_file import nearest


class Window:
    """Window on the screen; the program continues if it is closed."""

    def __init__(self, title: str, rate: float) -> None:
        """Open a window with this title, for at most ``rate`` pictures per second.

        Raises:
            ValueError: one line, if there is no screen, or Python has no tkinter.
        """
        try:
            import tkinter

            self._root: Any = tkinter.Tk()
        except (ImportError, RuntimeError, OSError) as error:
            raise ValueError(f"render_mode = 'human' needs tkinter: {error}") from error
        except tkinter.TclError as error:
            raise ValueError(f"render_mode = 'human' needs a screen: {error}; rgb_array needs none") from error
        self._root.title(title)
        self._root.protocol("WM_DELETE_WINDOW", self.close)
        self._open, self._period, self._next = True, 1.0 / rate, 0.0
        self._image = tkinter.PhotoImage(master=self._root)
        tkinter.Label(self._root, image=self._image).pack()

    def show(self, picture: Picture) -> None:
        """Show the picture, after the previous one has been shown for its period."""
        if not self._open:
            return
        time.sleep(max(0.0, self._next - time.monotonic()))
        self._next = time.monotonic() + self._period
        height, width = picture.shape[:2]
        self._image.configure(data=b"P6 %d %d 255\n" % (width, height) + picture.tobytes())
        self._root.update()

    def close(self) -> None:
        """Close the window; a second call has no effect."""
        if self._open:
            self._open = False
            self._root.destroy()


RenderMode = Literal["rgb_array", "human"]
_ONLY = np.zeros(1, dtype=np.intp)


class SingleEnv(gym.Env[Any, NDArray[np.float32]]):
    """Environment around a core of one episode.

    A copy (``copy.deepcopy``, ``pickle``) continues the episode bitwise like the original. Before the first reset it is
    built anew. An episode with a renderer cannot be copied.
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 50}  # noqa: RUF012  # as gymnasium declares it

    def __init__(self, build: Callable[[int], Core], render_mode: RenderMode | None = None) -> None:
        """``build(n)`` returns a core of n episodes.

        Raises:
            ValueError: one line, if an option does not fit.
        """
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode = '{render_mode}' must be one of rgb_array, human")
        self._build = build
        self.core = build(1)
        self.render_mode = render_mode
        self._window: Window | None = None
        self._open = self._closed = False  # open: between the first reset and close
        self.metadata = {**self.metadata, "render_fps": round(self.core.control_rate)}
        self.action_space, self.observation_space = self.core.action_space, self.core.observation_space
        self._shape = self.core.action_space.shape

    def __reduce__(self) -> tuple[Any, ...]:
        if not self._open:
            return (type(self), (self._build, self.render_mode))  # without an episode there is nothing else to copy
        return (copyreg.__newobj__, (type(self),), {**vars(self), "_window": None})  # type: ignore[attr-defined]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; the module of the environment lists the options.

        Raises:
            ValueError: one line, if the seed or an option is wrong.
            ClosedEnvironmentError: after ``close``.
        """
        if self._closed:
            raise call_error("reset", closed=True)
        given = reset_options(options)
        super().reset(seed=checked_seed(seed))
        self.core.begin(_ONLY, [self.np_random], given)
        self._open = True
        self._show()
        return of_lane(self.core.observe(), 0), self._info()

    def step(self, action: NDArray[np.float32]) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Advance by a control step.

        Raises:
            ValueError: one line, if the action is not finite numbers of the action space's shape.
            ResetNeeded: before the first ``reset``.
            ClosedEnvironmentError: after ``close``.
        """
        if not self._open:
            raise call_error("step", closed=self._closed)
        result = self.core.step(checked_actions(action, self._shape, "action")[None])
        info = self._info()
        if result.outcome[0]:
            info["outcome"] = result.outcome[0]
        self._show()
        ended, cut = bool(result.terminated[0]), bool(result.truncated[0])
        return of_lane(self.core.observe(), 0), float(result.reward[0]), ended, cut, info

    def render(self) -> Picture | None:
        """Top view of the episode, with its camera view if there is one, for ``rgb_array``.

        Raises:
            ClosedEnvironmentError: after ``close``.
        """
        if self._closed:
            raise call_error("render", closed=True)
        return self.core.picture(0) if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Close window and cameras; a second call has no effect."""
        self._open, self._closed = False, True
        self.core.close()
        if self._window is not None:
            self._window.close()
            self._window = None

    def _info(self) -> dict[str, Any]:
        return {name: values[0].item() for name, values in self.core.info().items()}

    def _show(self) -> None:
        if self.render_mode == "human":
            if self._window is None:
                self._window = Window("offtrack", self.metadata["render_fps"])
            self._window.show(self.core.picture(0))


Flags = NDArray[np.bool_]
_StepResult = tuple[Observation, NDArray[np.float64], Flags, Flags, dict[str, Any]]


class CoreVectorEnv(VectorEnv[Observation, NDArray[np.float32], NDArray[Any]]):
    """Environment around a core of many episodes; sub-environment k equals a single one with seed s + k.

    Copies are as those of a single one: exact in mid-episode, built anew before the first reset.
    """

    def __init__(
        self,
        build: Callable[[int], Core],
        num_envs: int = 1,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
    ) -> None:
        """``build(n)`` returns a core of n episodes.

        Raises:
            ValueError: one line, if an option does not fit.
        """
        num_envs = checked_count("num_envs", num_envs, MAX_ENVS)
        if autoreset_mode not in list(AutoresetMode) + [mode.value for mode in AutoresetMode]:
            modes = ", ".join(mode.value for mode in AutoresetMode)
            raise ValueError(f"autoreset_mode = {autoreset_mode!r:.80} must be one of {modes}")
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode = '{render_mode}' of a vector environment must be rgb_array")
        self._again = partial(CoreVectorEnv, build, num_envs, autoreset_mode=autoreset_mode, render_mode=render_mode)
        self._mode = AutoresetMode(autoreset_mode)
        self.core = build(num_envs)
        self.num_envs, self.render_mode = num_envs, render_mode
        rate = round(self.core.control_rate)
        self.metadata = {"autoreset_mode": self._mode, "render_modes": ["rgb_array"], "render_fps": rate}
        self.single_action_space = self.core.action_space
        self.single_observation_space = self.core.observation_space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._shape = (num_envs, *self.single_action_space.shape)
        self._generators: list[np.random.Generator] = []
        self._begun, self._done = np.zeros(num_envs, dtype=bool), np.zeros(num_envs, dtype=bool)
        self._open = False  # all episodes have begun, and the environment is not closed

    def __reduce__(self) -> tuple[Any, ...]:
        if self.closed or not self._begun.any():
            return (self._again, ())  # without an episode there is nothing else to copy
        return (copyreg.__newobj__, (type(self),), vars(self))  # type: ignore[attr-defined]

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin episodes in all sub-environments, or in those of ``options["reset_mask"]``.

        Raises:
            ValueError: one line, if a seed, the mask or an option is wrong.
            ClosedEnvironmentError: after ``close``.
        """
        if self.closed:
            raise call_error("reset", closed=True)
        given = reset_options(options)
        mask = np.asarray(given.pop("reset_mask", np.ones(self.num_envs, dtype=bool)))
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(f"reset_mask must be {self.num_envs} booleans, at least one of them True")
        self._seed(seed, mask)
        self._begin(mask, given)
        return self.core.observe(), self._masked(self.core.info(), mask)

    def step(self, actions: NDArray[np.float32]) -> _StepResult:
        """Advance all by a control step; ended episodes restart according to the autoreset mode.

        Raises:
            ValueError: one line, if the actions are not finite numbers (num_envs, n_action).
            ResetNeeded: before the first ``reset`` of all sub-environments.
            ClosedEnvironmentError: after ``close``.
        """
        if not self._open:
            raise call_error("step", closed=self.closed)
        result = self.core.step(checked_actions(actions, self._shape))
        if self._mode is AutoresetMode.NEXT_STEP:
            return self._after(self._restarted(result))
        if self._mode is AutoresetMode.SAME_STEP:
            return self._same_step(result)
        return self._after(result)

    def render(self) -> tuple[Picture, ...] | None:
        """Top view of every episode, for ``rgb_array``.

        Raises:
            ClosedEnvironmentError: after ``close``.
        """
        if self.closed:
            raise call_error("render", closed=True)
        if self.render_mode != "rgb_array":
            return None
        return tuple(self.core.picture(lane) for lane in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Close cameras."""
        self._open = False
        self.core.close()

    def _seed(self, seed: Any, mask: Flags) -> None:
        if isinstance(seed, Sequence | np.ndarray) and not isinstance(seed, str):
            seeds = [checked_seed(one) for one in seed]
        else:
            first = checked_seed(seed)
            seeds = [None if first is None else first + k for k in range(self.num_envs)]
        if len(seeds) != self.num_envs:
            raise ValueError(f"{len(seeds)} seeds for {self.num_envs} environments: give one per environment")
        fresh = not self._generators
        if fresh:
            self._generators = [np_random(s)[0] for s in seeds]
            return
        for lane in np.flatnonzero(mask).tolist():
            if seeds[lane] is not None:
                self._generators[lane] = np_random(seeds[lane])[0]

    def _begin(self, mask: Flags, options: dict[str, Any]) -> None:
        lanes = np.flatnonzero(mask)
        self.core.begin(lanes, [self._generators[lane] for lane in lanes.tolist()], options)
        self._done[mask], self._begun[mask] = False, True
        self._open = self._open or bool(self._begun.all())

    def _restarted(self, result: Result) -> Result:
        """Result with the episodes that ended one step earlier restarted; their actions are ignored."""
        again = self._done.copy()
        if not again.any():
            return result
        self._begin(again, {})
        going = ~again
        outcome = np.where(again, "", result.outcome)
        return Result(result.reward * going, result.terminated & going, result.truncated & going, outcome)

    def _after(self, result: Result) -> _StepResult:
        self._done = result.terminated | result.truncated
        return self.core.observe(), result.reward, result.terminated, result.truncated, self._info(result)

    def _same_step(self, result: Result) -> _StepResult:
        """Restart ended episodes at once; their last observations and infos are in the info."""
        done = result.terminated | result.truncated
        info = self._info(result)
        if done.any():
            last = self.core.observe()
            final = np.full(self.num_envs, None, dtype=object)
            for lane in np.flatnonzero(done).tolist():
                final[lane] = of_lane(last, lane)
            ended: dict[str, Any] = {"final_obs": final, "_final_obs": done}
            ended |= {"final_info": self._masked(self.core.info() | {"outcome": result.outcome}, done)}
            self._begin(done, {})
            info = {**self._info(result._replace(outcome=np.full(self.num_envs, "", dtype=object))), **ended}
            info["_final_info"] = done
        return self.core.observe(), result.reward, result.terminated, result.truncated, info

    def _info(self, result: Result) -> dict[str, Any]:
        info = self._masked(self.core.info(), np.ones(self.num_envs, dtype=bool))
        ended = result.terminated | result.truncated
        if ended.any() and result.outcome.any():
            info |= {"outcome": result.outcome, "_outcome": ended}
        return info

    @staticmethod
    def _masked(info: Info, mask: Flags) -> dict[str, Any]:
        """Info with a mask ``_name`` for each entry, as gymnasium defines it."""
        return {**info, **{f"_{name}": mask for name in info}}


class Repeated:
    """A core of n episodes whose actions each hold for several control steps of another core.

    Rewards are summed up to the end of an episode. An episode that ends before the last of these steps continues
    without reward and keeps its outcome.
    """

    def __init__(self, core: Core, times: int) -> None:
        """Repeat each action of ``core`` for ``times`` control steps, at least 1."""
        self._core, self._times = core, times
        self.n, self.action_space, self.observation_space = core.n, core.action_space, core.observation_space

    @property
    def control_rate(self) -> float:
        """Actions per second of simulated time [Hz]."""
        return self._core.control_rate / self._times

    def __getattr__(self, name: str) -> Any:
        if name == "_core":  # while a copy is being made
            raise AttributeError(name)
        return getattr(self._core, name)  # all else is the core's: begin, observe, info, picture, close, features

    def step(self, actions: NDArray[np.float32]) -> Result:
        """Advance all episodes by ``times`` control steps with the same actions."""
        total = self._core.step(actions)
        for _ in range(self._times - 1):
            result = self._core.step(actions)
            going = ~(total.terminated | total.truncated)
            total = Result(
                total.reward + result.reward * going,
                total.terminated | (result.terminated & going),
                total.truncated | (result.truncated & going),
                np.where(going, result.outcome, total.outcome),
            )
        return total


class Limited(Repeated):
    """A core of n episodes that are cut after a number of actions, as gymnasium's ``TimeLimit`` cuts a single one."""

    def __init__(self, core: Core, steps: int) -> None:
        """Cut the episodes of ``core`` after this number of ``steps``, at least 1."""
        super().__init__(core, 1)
        self._steps, self._elapsed = steps, np.zeros(core.n, dtype=np.intp)

    def begin(self, lanes: Lanes, generators: list[np.random.Generator], options: Mapping[str, Any]) -> None:
        """Begin episodes in these lanes."""
        self._core.begin(lanes, generators, options)
        self._elapsed[lanes] = 0

    def step(self, actions: NDArray[np.float32]) -> Result:
        """Advance all episodes by a step."""
        result = self._core.step(actions)
        self._elapsed += 1
        cut = (self._elapsed >= self._steps) & ~result.terminated
        outcome = np.where(cut & ~result.truncated, "timed out", result.outcome)
        return result._replace(truncated=result.truncated | cut, outcome=outcome)


CORES: Final[dict[str, tuple[Callable[[int, Any], Core], type[EnvironmentOptions]]]] = {  # core and its options
    "TrailerSteering-v0": (TrailerSteering, TrailerSteeringOptions),
    "TractorTrailerDriving-v0": (TractorTrailerDriving, TractorTrailerDrivingOptions),
    "RoverSteering-v0": (RoverSteering, RoverSteeringOptions),
}

_REPEAT: Final = "action_repeat"
_MAX_REPEAT: Final = 1000  # control steps
_LIMIT: Final = "max_episode_steps"
_MAX_STEPS: Final = 10**9


def single(name: str, render_mode: RenderMode | None = None, **options: Any) -> SingleEnv:
    """One environment of this name; besides its options, ``action_repeat`` repeats each action for that many steps.

    Raises:
        ValueError: one line, if an option is unknown or does not fit.
    """
    return SingleEnv(_builder(name, options), render_mode)


def vector(name: str, num_envs: int = 1, **options: Any) -> CoreVectorEnv:
    """Vector environment of this name; options also include ``autoreset_mode``, ``render_mode``, ``action_repeat``.

    ``max_episode_steps`` cuts every episode after that many steps, as ``gymnasium.make`` does for a single one.
    """
    own = {key: options.pop(key) for key in ("autoreset_mode", "render_mode") if key in options}
    return CoreVectorEnv(_builder(name, options, options.pop(_LIMIT, None)), num_envs, **own)


def _builder(name: str, options: dict[str, Any], limit: Any = None) -> Callable[[int], Core]:
    """Function that builds a core of n episodes; it can be pickled."""
    if name not in CORES:
        raise ValueError(f"unknown environment {name!r:.80}{nearest(str(name), CORES)}")
    repeat = checked_count(_REPEAT, options.pop(_REPEAT, 1), _MAX_REPEAT)
    steps = None if limit in (None, -1) else checked_count(_LIMIT, limit, _MAX_STEPS)  # gymnasium: -1 is no limit
    return partial(_core, name, repeat, steps, options)


def _core(name: str, repeat: int, steps: int | None, options: dict[str, Any], n: int) -> Core:
    build, options_type = CORES[name]
    core = build(n, options_type.of(options, name))
    repeated = core if repeat == 1 else Repeated(core, repeat)
    return repeated if steps is None else Limited(repeated, steps)
