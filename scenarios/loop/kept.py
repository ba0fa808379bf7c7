"""Rows that a run collects: the newest in memory, the rest in a temporary file."""

from __future__ import annotations

import os
import pickle
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from threading import Lock
from typing import Any, Generic, NamedTuple, TypeVar, cast, overload

ItemT = TypeVar("ItemT")


class _File:
    """A temporary file without a name; it goes with its last user."""

    def __init__(self) -> None:
        self._descriptor, name = tempfile.mkstemp(prefix="offtrack-")
        os.unlink(name)

    def __del__(self) -> None:
        os.close(self._descriptor)

    def stored(self, content: bytes) -> _Stored:
        """Write behind what is there.

        Raises:
            OSError: if there is no room.
        """
        offset, rest = os.lseek(self._descriptor, 0, os.SEEK_END), memoryview(content)
        while rest:
            rest = rest[os.write(self._descriptor, rest) :]
        return _Stored(self, offset, len(content))

    def read(self, offset: int, size: int) -> bytes:
        parts = bytearray()
        while len(parts) < size:
            parts += os.pread(self._descriptor, size - len(parts), offset + len(parts))
        return bytes(parts)


class _Stored(NamedTuple):
    """A chunk in a file."""

    file: _File
    offset: int
    size: int

    def load(self) -> list[Any]:
        return cast("list[Any]", pickle.loads(self.file.read(self.offset, self.size)))


class Kept(Sequence[ItemT], Generic[ItemT]):
    """A growing sequence whose memory does not grow: an hour has 360 000 rows of some kilobytes each.

    Items must not be changed. Those that can not be pickled stay in memory, and so do all if there is no room on disk.
    Copies share what is in the file. A thread may get single items while another one appends.
    """

    def __init__(self, chunk: int, items: Iterable[ItemT] = (), *, recent: int = 0) -> None:
        """A sequence of ``items`` with the newest in memory: ``recent`` and one to two times ``chunk``."""
        self._chunk, self._recent = chunk, recent
        self._older: list[_Stored | list[ItemT]] = []  # of one chunk each
        self._newest: list[ItemT] = []
        self._file: _File | None = None
        self._lock = Lock()  # while items change their place
        for item in items:
            self.append(item)

    def append(self, item: ItemT) -> None:
        """Add an item."""
        self._newest.append(item)
        if len(self._newest) >= self._recent + 2 * self._chunk:
            oldest = self._stored(self._newest[: self._chunk])
            with self._lock:
                del self._newest[: self._chunk]
                self._older.append(oldest)

    def __len__(self) -> int:
        return self._chunk * len(self._older) + len(self._newest)

    def __iter__(self) -> Iterator[ItemT]:
        for chunk in list(self._older):
            yield from _items(chunk)
        yield from self._newest

    @overload
    def __getitem__(self, index: int) -> ItemT: ...
    @overload
    def __getitem__(self, index: slice) -> list[ItemT]: ...
    def __getitem__(self, index: int | slice) -> ItemT | list[ItemT]:
        if isinstance(index, slice):
            opened: dict[int, list[ItemT]] = {}  # chunks, each read once
            return [self._at(place, opened) for place in range(len(self))[index]]
        with self._lock:
            place = index + len(self) if index < 0 else index
            if not 0 <= place < len(self):
                raise IndexError(index)
            return self._at(place, {})

    def _at(self, place: int, opened: dict[int, list[ItemT]]) -> ItemT:
        chunk, rest = divmod(place, self._chunk)
        if chunk >= len(self._older):
            return self._newest[place - self._chunk * len(self._older)]
        if chunk not in opened:
            opened[chunk] = _items(self._older[chunk])
        return opened[chunk][rest]

    def __deepcopy__(self, _: object) -> Kept[ItemT]:
        copied = Kept[ItemT](self._chunk, recent=self._recent)
        copied._older, copied._newest = list(self._older), list(self._newest)
        return copied

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(Kept, recent=self._recent), (self._chunk, list(self))

    def _stored(self, items: list[ItemT]) -> _Stored | list[ItemT]:
        try:
            content = pickle.dumps(items, protocol=pickle.HIGHEST_PROTOCOL)
            self._file = self._file or _File()
            return self._file.stored(content)
        except Exception:  # of a user's class, which may do anything; or no room is left
            return items


def _items(chunk: _Stored | list[ItemT]) -> list[ItemT]:
    return chunk.load() if isinstance(chunk, _Stored) else chunk
