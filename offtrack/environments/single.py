"""A single episode as a gymnasium environment, and the window that shows it."""

from __future__ import annotations

import copyreg
import time
from collections.abc import Callable
from typing import Any, Literal

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from offtrack.environments.core import Core, call_error, checked_actions, checked_seed, of_lane, reset_options
from offtrack.reports.canvas import Picture


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
