"""Hostile versions of valid files: damaged bytes, odd values in valid structures, lying headers, other things.

A format is a name in ``FORMATS``. Every format gets damaged bytes and other things in its place besides its own
mutations. Strategies give the content and a note on what was done.
"""

import gzip
import io
import json
import math
import re
import sqlite3
import struct
import tomllib
import zipfile
import zlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import date
from typing import Any, Final, cast, get_args

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import tomli_w
from hypothesis import strategies as st
from rosbags.rosbag2.reader import zstd

from tests.fuzz.case import Special

Hostile = tuple[bytes | Special, str]  # content, and what was done
Mutation = Callable[[bytes], st.SearchStrategy[Hostile]]

ODD_NUMBERS: Final = (
    *("nan", "inf", "-inf", "1e308", "-1e308", "1e400", "1e-320", "0", "-0.0", "-1", "0.5", "1e6", "1e12"),
    *("9" * 30, "9" * 5000, "0x10", "1_0", "--1", "1e", "", "one", "1,5", "\u0663", "1.7e+9"),
)
_ODD_VALUES: Final[tuple[Any, ...]] = (
    *(math.nan, math.inf, -math.inf, 1e308, -1e308, 1e-320, 0, 0.0, -1, -0.5, 3, 1e6, 1e12, 10**17, 10**30),
    *("", "x", "x" * 5000, "none", "nan", "[/b]", "a\nb", "../../etc/passwd", "os:system", "..:x", "é" * 50, "\u202e"),
    *(True, False, [], [[]], [1, 2], [0.0] * 4, ["a"], {}, {"kind": 3}, {"value": 1, "source": 2}, date(1, 1, 1)),
)
_PIECES: Final = (
    *(b"\x00", b"\xff" * 4, b"\xef\xbb\xbf", b"\xff\xfe", b"\n" * 100, b"\r", b'"', b"'''", b"\\u0000", b"# "),
    *(b"[" * 3000, b"{a=" * 2000, b"(" * 300, b"nan", b"1e999", b"-" * 50, b"9" * 5000, b"," * 500, b"a.b.c = 1\n"),
    *(b"[[course]]\n", b"a = " + b"[" * 200 + b"]" * 200 + b"\n", ("a" + ".a" * 1500 + " = 1\n").encode()),
)


def _png(width: int, height: int, depth: int = 8, kind: int = 0, data: bytes | None = None) -> bytes:
    """A grey PNG file whose header may lie."""

    def chunk(name: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))

    head = struct.pack(">IIBBBBB", width, height, depth, kind, 0, 0, 0)
    body = zlib.compress(b"\x00" * 1000) if data is None else data
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


def _large_png(side: int) -> bytes:
    packer = zlib.compressobj(9)
    rows = bytes(side + 1) * 64
    body = b"".join(packer.compress(rows) for _ in range(side // 64)) + packer.flush()
    return _png(side, side // 64 * 64, data=body)


def _npy(shape: str, dtype: str = "<f8", data: bytes = b"\x00" * 64, header: int | None = None) -> bytes:
    """A NumPy file whose header may lie."""
    text = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}".encode()
    text += b" " * ((header or 0) - len(text)) + b"\n"
    return b"\x93NUMPY\x02\x00" + struct.pack("<I", len(text)) + text + data


def _zip_of(members: Mapping[str, bytes], *, packed: bool = True) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED if packed else zipfile.ZIP_STORED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return file.getvalue()


def _mcap(chunk: bytes, size: int) -> bytes:
    """An MCAP file of one compressed chunk, without an index."""
    mark = b"\x89MCAP0\r\n"
    records = {
        1: struct.pack("<I4sI", 4, b"ros2", 0),
        6: struct.pack("<QQQII4sQ", 0, 1, size, 0, 4, b"zstd", len(chunk)) + chunk,
        2: bytes(20),
    }
    return mark + b"".join(struct.pack("<BQ", code, len(body)) + body for code, body in records.items()) + mark


_EPS: Final = (
    b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n(planted) (w) file (boo) writestring {} loop\nshowpage\n%%EOF\n"
)
_OTHERS: Final[Mapping[str, Callable[[], bytes]]] = {
    "empty": lambda: b"",
    "one line end": lambda: b"\n",
    "eps": lambda: _EPS,
    "zstd bomb": lambda: zstd.compress(bytes(2**26)) * 64,
    "mcap bomb": lambda: _mcap(zstd.compress(bytes(2**26)) * 64, 2**32),
    "yaml of aliases": lambda: (
        b"a0: &a0 [1, 2]\n"
        + b"".join(b"a%d: &a%d [%s]\n" % (k, k, b", ".join([b"*a%d" % (k - 1)] * 9)) for k in range(1, 12))
    ),
    "gzip bomb": lambda: gzip.compress(bytes(20_000_000)),
    "zip bomb": lambda: _zip_of({"W0.npy": _npy("(30000, 10000)", data=bytes(300_000_000))}),
    "zip without members": lambda: _zip_of({}),
    "png 60000x60000": lambda: _png(60_000, 60_000),
    "png 0x0": lambda: _png(0, 0),
    "png 1x1": lambda: _png(1, 1, data=zlib.compress(b"\x00\x07")),
    "png of 12000x12000 black pixels": lambda: _large_png(12_000),
    "npy of 10**12 numbers": lambda: _npy("(1000000, 1000000)"),
    "npy with a negative shape": lambda: _npy("(-1, 4)"),
    "npy of objects": lambda: _npy("(4, 4)", "|O", b"cos\nsystem\n(S'touch planted'\ntR."),
    "npy with a header of 50 MB": lambda: _npy("(4, 4)", header=50_000_000),
    "npy with code in its header": lambda: _npy("__import__('os').system('touch planted')"),
    "npy with a nested header": lambda: _npy("(" * 5000 + ")" * 5000),
    "deep toml": lambda: b"a = " + b"[" * 20_000 + b"]" * 20_000,
    "deep tables": lambda: b"[" + b".".join([b"a"] * 20_000) + b"]\n",
    "deep inline tables": lambda: b"a = " + b"{a = " * 5000 + b"1" + b"}" * 5000,
    "deep json": lambda: b"[" * 100_000 + b"]" * 100_000,
    "long line": lambda: b"x" * 3_000_000,
    "long cell": lambda: b"time_s,steer_deg,speed_kmh\n0,0,10\n1," + b"1" * 200_000 + b",10\n",
    "many lines": lambda: b"1 2 3\n" * 1_000_000,
    "utf-16": lambda: "name = 'x'\n".encode("utf-16"),
    "latin-1": lambda: b"name = '\xe9'\n",
    "parquet magic": lambda: b"PAR1" + b"\x00" * 20 + b"\xff\xff\xff\x7fPAR1",
    "elf": lambda: b"\x7fELF\x02\x01\x01" + b"\x00" * 200,
    "svg": lambda: b"<svg xmlns='http://www.w3.org/2000/svg'/>",
    "gif": lambda: b"GIF89a\xff\xff\xff\xff\x00\x00\x00;",
    "tiff that points at itself": lambda: b"II*\x00\x08\x00\x00\x00\x00\x00\x08\x00\x00\x00",
    "bmp 30000x30000": lambda: (
        b"BM" + struct.pack("<IHHIIiiHHIIIIII", 100, 0, 0, 54, 40, 30000, 30000, 1, 24, *[0] * 6)
    ),
    "pgm 100000x100000": lambda: b"P5\n100000 100000\n255\n\x00",
    "pickle": lambda: b"cos\nsystem\n(S'touch planted'\ntR.",
}
OTHER_THINGS: Final = (*_OTHERS, *get_args(Special))


def other_thing(name: str) -> Hostile:
    return (_OTHERS[name]() if name in _OTHERS else name), f"{name} in its place"  # type: ignore[return-value]


def damaged(content: bytes) -> st.SearchStrategy[Hostile]:
    place = st.floats(0.0, 1.0).map(lambda share: int(share * len(content)))
    flips = st.lists(st.tuples(place, st.integers(0, 7)), min_size=1, max_size=20)
    return st.one_of(
        flips.map(lambda chosen: _flipped(content, chosen)),
        place.map(lambda k: (content[:k], f"cut at byte {k}")),
        st.tuples(place, st.integers(1, 200)).map(lambda c: (content[: c[0]] + content[sum(c) :], "a part cut out")),
        st.tuples(place, st.sampled_from(_PIECES) | st.binary(min_size=1, max_size=40)).map(
            lambda c: (content[: c[0]] + c[1] + content[c[0] :], f"{c[1][:12]!r} put in at byte {c[0]}")
        ),
        st.tuples(place, st.integers(1, 300), st.integers(2, 50)).map(
            lambda c: (content[: c[0]] + content[c[0] : c[0] + c[1]] * c[2] + content[c[0] :], "a part repeated")
        ),
        st.tuples(place, place).map(lambda c: (content[: c[0]] + content[c[1] :], "head and tail joined")),
    )


def _flipped(content: bytes, flips: list[tuple[int, int]]) -> Hostile:
    changed = bytearray(content)
    for place, bit in flips:
        if place < len(changed):
            changed[place] ^= 1 << bit
    return bytes(changed), f"{len(flips)} bits flipped"


_NUMBER: Final = re.compile(rb"-?\d+(\.\d+)?(e[+-]?\d+)?")


def _text(content: bytes) -> st.SearchStrategy[Hostile]:
    lines = content.splitlines(keepends=True)
    line = st.integers(0, max(0, len(lines) - 1))
    return st.one_of(
        st.tuples(st.floats(0.0, 1.0), st.sampled_from(ODD_NUMBERS)).map(lambda c: _other_number(content, *c)),
        st.tuples(line, line).map(lambda c: (b"".join([*lines[c[0] :], *lines[: c[1]]]), "parts of lines exchanged")),
        line.map(lambda k: (b"".join([*lines[:k], *lines[k + 1 :]]), "a line left out")),
        line.map(lambda k: (b"".join([*lines[: k + 1], *lines[k:]]), "a line twice")),
        line.map(lambda k: (b"".join(lines[:k]), "the last lines left out")),
        st.tuples(line, st.sampled_from([b",1", b" 1", b",", b'"', b"\t", b";0", b" nan"])).map(
            lambda c: (
                b"".join([*lines[: c[0]], lines[c[0]].rstrip() + c[1] + b"\n", *lines[c[0] + 1 :]]),
                "a longer line",
            )
        ),
        st.just((content.replace(b"\n", b"\r"), "old line ends")),
        st.just((content * 200, "repeated 200 times")),
    )


def _other_number(content: bytes, share: float, number: str) -> Hostile:
    places = [match.span() for match in _NUMBER.finditer(content)]
    if not places:
        return content, "nothing"
    begin, end = places[min(int(share * len(places)), len(places) - 1)]
    return content[:begin] + number.encode() + content[end:], f"{content[begin:end]!r} is now {number[:20]}"


def _tree(load: Callable[[bytes], Any], dump: Callable[[Any], bytes]) -> Mutation:
    def changed(content: bytes) -> st.SearchStrategy[Hostile]:
        paths = list(_paths(load(content)))

        def apply(choice: tuple[list[Any], str, Any]) -> Hostile:
            path, action, value = choice
            root = load(content)
            node: Any = root
            *parents, key = path
            for part in parents:
                node = node[part]
            if action == "left out":
                del node[key]
            elif action == "twice" and isinstance(node, list):
                node.extend([node[key]] * 50)
            elif action == "renamed" and isinstance(node, dict):
                node[f"{key}_"] = node.pop(key)
            elif action == "added" and isinstance(node, dict):
                node["extra"] = value
            else:
                node[key] = value
            try:
                return dump(
                    root
                ), f"{'.'.join(map(str, path))} {action} {str(value)[:20] if action == 'set to' else ''}"
            except (TypeError, ValueError, RecursionError):
                return content, "nothing"

        actions = st.sampled_from(["set to"] * 6 + ["left out", "twice", "renamed", "added"])
        return st.tuples(st.sampled_from(paths), actions, st.sampled_from(_ODD_VALUES)).map(apply)

    return changed


def _paths(node: Any, path: tuple[str | int, ...] = ()) -> Any:
    children = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, child in children:
        yield [*path, key]
        yield from _paths(child, (*path, key))


_toml = _tree(lambda content: tomllib.loads(content.decode()), lambda root: tomli_w.dumps(root).encode())
_json = _tree(json.loads, lambda root: json.dumps(root).encode())


def _image(content: bytes) -> st.SearchStrategy[Hostile]:
    side = st.sampled_from([0, 1, 2, 63, 255, 4097, 30_000, 65_535, 2**31 - 1, 2**32 - 1])
    depth, kind = st.sampled_from([0, 1, 2, 8, 16, 99]), st.sampled_from([0, 2, 3, 4, 6, 7])
    data = content[content.index(b"IDAT") + 4 : -16]
    return st.tuples(side, side, depth, kind).map(lambda c: (_png(*c, data=data), f"header of {c[0]}x{c[1]}, {c[2:]}"))


_ODD_ARRAYS: Final[tuple[Any, ...]] = (
    *(np.zeros((0,)), np.zeros((3, 4, 5)), np.full((4, 4), np.nan), np.full((4, 4), 1e308), np.zeros(()), np.eye(4)),
    *(np.array(["a", "b"]), np.array([b"a"]), np.zeros((4, 4), dtype=bool), np.zeros((4, 4), dtype=complex)),
    *(np.zeros(4, dtype=[("a", float), ("b", int)]), np.array(["2020-01-01"], dtype="datetime64[D]")),
    *(np.zeros((5, 5), dtype=np.float16), np.full((6, 6), 2**63, dtype=np.uint64), np.zeros((2, 2000))),
)


def _saved(array: Any) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def _array(content: bytes) -> st.SearchStrategy[Hostile]:
    return st.sampled_from(_ODD_ARRAYS).map(lambda array: (_saved(array), f"{array.dtype} of shape {array.shape}"))


def _archive(content: bytes) -> st.SearchStrategy[Hostile]:
    """A zip file with another member, one less, or one that is damaged or edited."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name, packed = st.sampled_from(sorted(members)), st.booleans()
    things = st.sampled_from([*map(_saved, _ODD_ARRAYS), b"", b"\x93NUMPY", _OTHERS["npy of 10**12 numbers"](), _EPS])
    changed = name.flatmap(lambda one: st.tuples(st.just(one), st.one_of(_text(members[one]), damaged(members[one]))))
    return st.one_of(
        st.tuples(name, things, packed).map(lambda c: (_zip_of({**members, c[0]: c[1]}, packed=c[2]), f"odd {c[0]}")),
        changed.map(lambda c: (_zip_of({**members, c[0]: cast(bytes, c[1][0])}), f"{c[0]}: {c[1][1]}")),
        name.map(lambda one: (_zip_of({k: v for k, v in members.items() if k != one}), f"without {one}")),
        st.just((_encrypted(content), "said to be encrypted")),
    )


def _encrypted(content: bytes) -> bytes:
    changed = bytearray(content)
    for mark, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        place = changed.find(mark)
        while place >= 0:
            changed[place + offset] |= 1
            place = changed.find(mark, place + 4)
    return bytes(changed)


_COLUMNS: Final[Mapping[str, Callable[[pa.Table, str, int], pa.Table]]] = {
    "left out": lambda table, name, k: table.remove_column(k),
    "of text": lambda table, name, k: table.set_column(k, name, pa.array(["x"] * len(table))),
    "of nulls": lambda table, name, k: table.set_column(k, name, pa.nulls(len(table))),
    "of NaN": lambda table, name, k: table.set_column(k, name, pa.array([math.nan] * len(table))),
    "of inf": lambda table, name, k: table.set_column(k, name, pa.array([math.inf] * len(table))),
    "of lists": lambda table, name, k: table.set_column(k, name, pa.array([[1.0]] * len(table))),
    "reversed": lambda table, name, k: table.set_column(k, name, table[name].take(list(range(len(table)))[::-1])),
    "without rows": lambda table, name, k: table.slice(0, 0),
    "with one row": lambda table, name, k: table.slice(0, 1),
}


def _table(content: bytes) -> st.SearchStrategy[Hostile]:
    table = pq.read_table(io.BytesIO(content))

    def changed(choice: tuple[str, str]) -> Hostile:
        file = io.BytesIO()
        pq.write_table(_COLUMNS[choice[1]](table, choice[0], table.schema.get_field_index(choice[0])), file)
        return file.getvalue(), " ".join(choice)

    return st.tuples(st.sampled_from(table.column_names), st.sampled_from(list(_COLUMNS))).map(changed)


_ODD_CELLS: Final[tuple[Any, ...]] = (
    *(None, -1, 0, 2**40, 1.5, "", "x", "/stereo/left/image_raw", "sensor_msgs/msg/Imu", "e" * 5000),
    *(b"", b"\x00\x01\x00\x00", b"\x00\x01\x00\x00" + b"\xff" * 64, zstd.compress(bytes(2**26)) * 64),
)


def _database(content: bytes) -> st.SearchStrategy[Hostile]:
    """A SQLite file with an odd or damaged cell, or without rows."""

    def edited(table: str, column: str, value: Any, row: float) -> Hostile:
        with sqlite3.connect(":memory:") as database:
            database.deserialize(content)
            ids = [one for (one,) in database.execute(f"SELECT rowid FROM {table}")]
            where = "" if row > 0.8 or not ids else f" WHERE rowid = {ids[int(row * len(ids))]}"
            with suppress(sqlite3.IntegrityError):  # a key must be a number
                if value == "left out":
                    database.execute(f"DELETE FROM {table}{where}")
                else:
                    database.execute(f"UPDATE OR IGNORE {table} SET {column} = ?{where}", (value,))
            database.commit()
            return database.serialize(), f"{table}.{column}{where} is {value!r:.40}"

    with sqlite3.connect(":memory:") as database:
        database.deserialize(content)
        tables = [name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        columns = [(table, row[1]) for table in tables for row in database.execute(f"PRAGMA table_info({table})")]
        (message,) = database.execute("SELECT data FROM messages ORDER BY id DESC").fetchone()
    odd = st.tuples(st.sampled_from(columns), st.sampled_from([*_ODD_CELLS, "left out"]), st.floats(0.0, 1.0))
    cut = st.tuples(st.just(("messages", "data")), damaged(message).map(lambda one: one[0]), st.floats(0.0, 1.0))
    return (odd | cut).map(lambda c: edited(*c[0], *c[1:]))


def _packed(content: bytes) -> st.SearchStrategy[Hostile]:
    """A file packed by zstd, whose content is damaged."""
    whole = zstd.decompress(content)
    return damaged(whole).map(lambda one: (zstd.compress(cast(bytes, one[0])), f"unpacked: {one[1]}"))


FORMATS: Final[Mapping[str, tuple[Mutation, ...]]] = {
    "toml": (_toml, _toml, _text),
    "json": (_json, _text),
    "text": (_text,),
    "image": (_image,),
    "npy": (_array,),
    "zip": (_archive,),
    "database": (_database,),
    "zstd": (_packed,),
    "parquet": (_table,),
    "binary": (),
}


def hostile(content: bytes, format_: str) -> st.SearchStrategy[Hostile]:
    """Hostile versions of a valid file: half of them with its own mutations."""
    own = [mutation(content) for mutation in FORMATS[format_]]
    return st.one_of(*own, damaged(content), st.sampled_from(OTHER_THINGS).map(other_thing))
