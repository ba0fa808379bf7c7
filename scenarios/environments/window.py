"""A window on the screen that shows pictures, with what Python itself brings."""

from __future__ import annotations

import time
from typing import Any

from scenarios.report.canvas import Picture


class Window:
    """Opens with the first picture; who closes it goes on without it."""

    def __init__(self, title: str, rate: float) -> None:
        """A window of this title, for at most so many pictures a second.

        Raises:
            ValueError: one line, if there is no screen, or Python has come without tkinter.
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
        """The picture, as soon as the one before has been there for its time."""
        if not self._open:
            return
        time.sleep(max(0.0, self._next - time.monotonic()))
        self._next = time.monotonic() + self._period
        height, width = picture.shape[:2]
        self._image.configure(data=b"P6 %d %d 255\n" % (width, height) + picture.tobytes())
        self._root.update()

    def close(self) -> None:
        """Takes it from the screen; closing twice does no harm."""
        if self._open:
            self._open = False
            self._root.destroy()
