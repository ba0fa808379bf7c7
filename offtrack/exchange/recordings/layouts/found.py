"""The layout of a recording, and the recording as a folder of image pairs.

A layout is a module: ``fits`` looks at a path, ``unpack`` writes its images, times and calibration into a folder, as
``offtrack run --record`` does. What fits none is such a folder itself, with the names of one program or another.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, NamedTuple, Protocol

from offtrack.exchange.recordings.layouts import bags, videos
from offtrack.exchange.recordings.stereo_sequence import Wanted
from scenarios.progress import Progress, no_progress
from vehicle.foundation.temporary import temporary_folder


class Layout(Protocol):
    """A way to keep the images of a stereo camera that is no folder of image pairs."""

    def fits(self, path: Path) -> bool:
        """True if this is how the path holds a recording."""

    def unpack(self, path: Path, folder: Path, wanted: Wanted, progress: Progress) -> tuple[str, ...]:
        """Write the recording into an empty folder; return what was noticed.

        Raises:
            ValueError: one line, if it can not be read or used.
        """


_LAYOUTS: Final[tuple[Layout, ...]] = (bags, videos)


class Unpacked(NamedTuple):
    """Folder with a recording, and what was noticed."""

    folder: Path
    notes: tuple[str, ...] = ()


@contextmanager
def unpacked(path: Path, wanted: Wanted | None = None, progress: Progress = no_progress) -> Iterator[Unpacked]:
    """Folder as ``offtrack estimate`` reads it; one that was unpacked is removed at the end.

    Raises:
        ValueError: one line, if it can not be unpacked; errors that what is done with the folder raises name the path.
    """
    wanted = wanted or Wanted()
    layout = next((one for one in _LAYOUTS if one.fits(path)), None)
    if wanted.topics and layout is not bags:
        raise ValueError(f"--topics {','.join(map('='.join, wanted.topics.items()))}: {path} is no bag")
    if layout is None:
        yield Unpacked(path)
        return
    with temporary_folder() as temporary:
        folder = temporary / (path.stem if path.is_file() else path.resolve().name)
        folder.mkdir()
        notes = layout.unpack(path, folder, wanted, progress)
        try:
            yield Unpacked(folder, notes)
        except ValueError as error:
            place = path.parent if layout is videos and path.is_file() else path
            raise ValueError(str(error).replace(str(folder), str(place))) from error
