"""A window on the screen that shows pictures, with what Python itself brings."""

from __future__ import annotations

from typing import Any

from scenarios.canvas import Picture


class Window:
    """Opens with the first picture."""

    def __init__(self, title: str) -> None:
        """A window of this title.

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
        self._image = tkinter.PhotoImage(master=self._root)
        tkinter.Label(self._root, image=self._image).pack()

    def show(self, picture: Picture) -> None:
        """The picture, at once."""
        height, width = picture.shape[:2]
        self._image.configure(data=b"P6 %d %d 255\n" % (width, height) + picture.tobytes())
        self._root.update()

    def close(self) -> None:
        """Takes it from the screen."""
        self._root.destroy()
