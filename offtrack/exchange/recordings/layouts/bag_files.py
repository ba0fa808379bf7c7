"""Files of ROS bags, opened by rosbags (extra ``export``), which needs no ROS; what unpacks to gigabytes is refused."""

import resource
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

from scenarios.extras import import_extra
from vehicle.foundation.temporary import FULL
from vehicle.foundation.user_file import shown

_ENDINGS: Final = (".mcap", ".db3", ".bag", ".zstd")
_UNPACKED: Final = 1_000_000_000  # of a message, or a chunk of them [bytes]
_UNPACKED_FILE: Final = 100  # times its size, and ``_UNPACKED``
_ZSTD: Final = b"\x28\xb5\x2f\xfd"  # begins what is packed; a message begins with a zero
OF_OWN: Final = "Of a run of offtrack, 'offtrack export RUN --to rosbag2 --images DIR' writes a bag with images"


class Received(NamedTuple):
    """A message of a bag."""

    topic: str
    time: int  # of its reception [ns]
    message: Any


class Bag(NamedTuple):
    """An open bag."""

    reader: Any  # of rosbags
    kinds: Mapping[str, str]  # of the messages by topic

    def count(self, *topics: str) -> int:
        """Number of messages."""
        return sum(one.msgcount for one in self.reader.connections if one.topic in topics)

    def messages(self, *topics: str) -> Iterator[Received]:
        """Messages in the order of their reception; a topic has one kind of them."""
        wanted = [
            one for one in self.reader.connections if one.topic in topics and one.msgtype == self.kinds[one.topic]
        ]
        packed = self.reader.messages(wanted) if wanted else iter(())
        while True:
            with _limited_memory():
                if (found := next(packed, None)) is None:
                    return
                connection, received, data = found
                data = _zstd().decompress(data) if data[:4] == _ZSTD else data
                message = self.reader.deserialize(data, connection.msgtype)
            yield Received(connection.topic, received, message)


def bag_files(path: Path) -> list[Path]:
    """Files of messages: the path itself, or those in a folder."""
    inside = path.iterdir() if path.is_dir() else [path]
    return sorted(file for file in inside if file.suffix in _ENDINGS and file.is_file())


@contextmanager
def opened_bag(path: Path, place: Path) -> Iterator[Bag]:
    """Open a bag; files go to a new folder ``place``.

    Raises:
        ValueError: one line with the path, if the package is missing, or the bag can not be read or used.
    """
    highlevel = import_extra("export", f"{path}: bags need", "rosbags.highlevel")
    try:
        reader = highlevel.AnyReader(_linked(path, place), default_typestore=humble_types())
        with _limited_memory():
            reader.open()
        with closing(reader):
            yield Bag(reader, {connection.topic: connection.msgtype for connection in reader.connections})
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    except Exception as error:  # most of the reader, whatever the bag makes it stumble over
        if isinstance(error, MemoryError) or getattr(error, "errno", None) in FULL:
            raise
        line = " ".join(str(error).split()).replace(f"{place}/", "")
        if "Profile is not ros2" in line:
            raise ValueError(f"{path}: its MCAP messages are those of a viewer, not of ROS 2. {OF_OWN}") from None
        raise ValueError(
            f"{path}: can not be read as a bag: {type(error).__name__}: {shown(line, 120)}. If it was cut off, try "
            "`ros2 bag reindex`, `mcap recover` or `rosbag reindex`"
        ) from None


def humble_types() -> Any:
    """Messages of ROS 2 Humble."""
    typesys = import_extra("export", "bags need", "rosbags.typesys")
    return typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)


def _zstd() -> Any:
    return import_extra("export", "bags need", "rosbags.rosbag2.reader").zstd


def _linked(bag: Path, place: Path) -> list[Path]:
    """Links to the files of a bag under plain names, as a database is opened by an address; packed ones are unpacked.

    Metadata are not read: they repeat what the files hold, and may name others.
    """
    place.mkdir()
    links = []
    for k, file in enumerate(bag_files(bag)):
        links.append(place / f"{k}{file.with_suffix('').suffix if file.suffix == '.zstd' else file.suffix}")
        if file.suffix != ".zstd":
            links[-1].symlink_to(file.absolute())
            continue
        most = _UNPACKED + _UNPACKED_FILE * file.stat().st_size
        with _zstd().open(file, "rb") as packed, links[-1].open("wb") as out:
            while part := packed.read(1_000_000):
                if out.write(part) and out.tell() > most:
                    raise ValueError(f"{file.name} unpacks to more than {most / 1e6:.0f} MB")
    if not links:
        raise ValueError("can not be read as a bag: it holds no file of messages")
    return links


@contextmanager
def _limited_memory() -> Iterator[None]:
    """Let memory grow by at most ``_UNPACKED``: libraries unpack whatever a bag says that it holds."""
    limits = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    most = pages * resource.getpagesize() + _UNPACKED
    resource.setrlimit(resource.RLIMIT_AS, (min({most, *limits[:1]} - {resource.RLIM_INFINITY}), limits[1]))
    try:
        yield
    except MemoryError:
        raise ValueError(f"a message unpacks to more than {_UNPACKED / 1e6:.0f} MB of memory") from None
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limits)
