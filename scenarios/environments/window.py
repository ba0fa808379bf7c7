"""Window that shows pictures, with tkinter."""

from __future__ import annotations

import time
from typing import Any

from scenarios.report.canvas import Picture


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
