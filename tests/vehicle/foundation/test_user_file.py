"""Files that a user names: regular, small enough, of the kind that they should be, or one line."""

import io
import socket
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controllers.trailer_steering.policy import NETWORK_FILE
from tests.hostile_files import HOSTILE
from vehicle.foundation.data_file import read_archive, read_array, read_arrays
from vehicle.foundation.user_file import MAX_MEMBERS, MAX_NESTING, FileKind, full_path, read_bytes, read_text, read_toml
from vehicle.rover.terrain import load_height_map

COMPLAINTS = {
    "pipe": "is a named pipe: a parameter file must be a regular file",
    "endless device": "is a device: a parameter file must be a regular file",
    "empty device": "is a device: a parameter file must be a regular file",
    "folder": "is a folder: a parameter file must be a regular file",
    "circle of links": "cannot be read: its symbolic links form a circle",
    "sparse": "has 3000 MB: a parameter file must have at most 1 MB",
    "random bytes": "not a text in UTF-8",
    "not UTF-8": "not a text in UTF-8: byte 0xf6 at 2; save it as UTF-8",
    "null characters": "not a TOML file",
}


@pytest.mark.parametrize("kind", COMPLAINTS)
def test_a_file_that_is_not_plain_text_of_that_size_is_refused_at_once(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    HOSTILE[kind](path)
    with pytest.raises(ValueError, match=r"^[^\n]*$") as refusal:
        read_toml(path)
    assert str(path) in str(refusal.value)
    assert COMPLAINTS[kind] in str(refusal.value)


def test_a_socket_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # the name of a socket must be short
    with socket.socket(socket.AF_UNIX) as server:
        server.bind("here")
        with pytest.raises(ValueError, match="is a socket"):
            read_bytes(Path("here"), FileKind.TABLE)


@pytest.mark.parametrize("kind", FileKind)
def test_each_kind_has_its_own_limit(kind: FileKind, tmp_path: Path) -> None:
    """A file of exactly the limit passes the check of its size; it is sparse, so it costs no disk."""
    path = tmp_path / "file"
    for extra, words in ((0, ""), (1, f"{kind.noun} must have at most {kind.limit / 1e6:g} MB")):
        with path.open("wb") as file:
            file.truncate(kind.limit + extra)
        if words:
            with pytest.raises(ValueError, match=words):
                read_bytes(path, kind)
        elif kind.limit <= 2_000_000:
            assert len(read_bytes(path, kind)) == kind.limit


def test_a_file_that_states_no_size_is_read_to_the_limit(tmp_path: Path) -> None:
    """Files of /proc have size 0, whatever they contain."""
    assert read_bytes(Path("/proc/self/status"), FileKind.PARAMETERS).startswith(b"Name:")


@pytest.mark.parametrize(
    "text",
    [
        "a = " + "[" * 5000 + "]" * 5000,
        "a = " + "{a=" * 5000 + "1" + "}" * 5000,
        "a = " + "[" * (MAX_NESTING + 1) + "]" * (MAX_NESTING + 1),
        ".".join("a" * 300_000) + " = 1",
        "[" + " . ".join(['"a"'] * 100_000) + "]",
        "a = " + "9" * 10_000,
    ],
    ids=["lists", "tables", "just too deep", "dotted key", "quoted key", "digits"],
)
def test_toml_that_exhausts_the_parser_is_refused_in_one_line(text: str, tmp_path: Path) -> None:
    """The parser recurses into each list, and takes quadratic time for the parts of a key."""
    path = tmp_path / "deep.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=r"^.*deep\.toml: not a TOML file: [^\n]{1,100}$"):
        read_toml(path)


def test_toml_of_the_allowed_depth_is_read(tmp_path: Path) -> None:
    path = tmp_path / "deep.toml"
    path.write_text(".".join("a" * (MAX_NESTING - 1)) + " = [1.5, 2.5]\n# " + "a." * 100, encoding="utf-8")
    node: Any = read_toml(path)
    for _ in range(MAX_NESTING - 1):
        node = node["a"]
    assert node == [1.5, 2.5]


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path: Path) -> None:
    (tmp_path / "marked").write_bytes(b"\xef\xbb\xbfa = 1")
    assert read_text(tmp_path / "marked", FileKind.PARAMETERS) == "a = 1"


def test_a_path_with_a_null_character_is_refused() -> None:
    for read in (full_path, lambda path: read_bytes(Path(path), FileKind.TABLE)):
        with pytest.raises(ValueError, match="a path must not contain a null character"):
            read("a\0b")


def test_the_full_path_follows_links_of_folders_and_keeps_the_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A vehicle is a file if its name ends in ``.toml``, wherever a link of that name leads."""
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to("folder")
    (tmp_path / "folder" / "mine.toml").symlink_to("data")
    monkeypatch.chdir(tmp_path)
    assert full_path("link/mine.toml") == str(tmp_path.resolve() / "folder" / "mine.toml")
    assert full_path("link/..") == full_path(".") == full_path("") == str(tmp_path.resolve())


def test_the_full_path_of_a_circle_of_links_is_a_path(tmp_path: Path) -> None:
    """``Path.resolve`` raises RuntimeError for it."""
    (tmp_path / "circle").symlink_to("circle")
    for name in ("circle", "circle/mine.toml"):
        assert full_path(tmp_path / name).endswith(name)


# Arrays and archives: nothing is unpacked or allocated that the file does not justify


def array_of(descr: str, shape: str, content: bytes = b"", padding: int = 0) -> bytes:
    """A .npy file whose header says what it is told to."""
    header = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}".encode() + b" " * padding + b"\n"
    return b"\x93NUMPY\x02\x00" + struct.pack("<I", len(header)) + header + content


def archive_of(members: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return stream.getvalue()


def encrypted(content: bytes) -> bytes:
    """The archive with the flag of encryption set in both headers of its first member."""
    changed = bytearray(content)
    changed[6] |= 1
    changed[content.index(b"PK\x01\x02") + 8] |= 1
    return bytes(changed)


def understated(size: int) -> bytes:
    """An archive with one member that unpacks to more than the ten bytes that it states."""
    content = bytearray(archive_of({"W0.npy": bytes(size)}))
    central = content.index(b"PK\x01\x02")
    content[22:26] = content[central + 24 : central + 28] = struct.pack("<I", 10)
    return bytes(content)


ARRAYS = {
    "3 GB in 100 bytes": (array_of("'<f8'", "(20000, 20000)"), "must have at most 16000000 elements"),
    "incomplete": (array_of("'<f8'", "(4, 4)", bytes(100)), "has 100 bytes for 16 elements"),
    "negative": (array_of("'<f8'", "(-4, -4)", bytes(128)), r"shape \(-4, -4\)"),
    "huge header": (array_of("'<f8'", "(4, 4)", bytes(128), padding=1_000_000), "header is damaged"),
    "nested header": (array_of("'<f8'", "(" * 900 + ")" * 900), "header is damaged"),
    "objects": (array_of("'|O'", "(2,)", b"\x80\x04K\x00."), "type object: they must be numbers or words"),
    "records": (array_of("[('a', '<f8')]", "(2,)", bytes(16)), "they must be numbers or words"),
    "no width": (array_of("'<U0'", "(2,)"), "they must be numbers or words"),
    "text": (b"1, 2, 3", "cannot be read as .npy"),
    "empty": (b"", "cannot be read as .npy"),
}


@pytest.mark.parametrize("case", ARRAYS)
def test_an_array_that_its_file_does_not_hold_is_refused(case: str, tmp_path: Path) -> None:
    content, words = ARRAYS[case]
    (tmp_path / "a.npy").write_bytes(content)
    with pytest.raises(ValueError, match=rf"^[^\n]*a\.npy[^\n]*{words}[^\n]*$"):
        load_height_map(str(tmp_path / "a.npy"), 0.5)
    (tmp_path / "a.npz").write_bytes(archive_of({"W0.npy": content}))
    with pytest.raises(ValueError, match=rf"^[^\n]*a\.npz, W0\.npy[^\n]*{words}[^\n]*$"):
        read_arrays(tmp_path / "a.npz", NETWORK_FILE)


def test_arrays_are_read_as_they_were_written(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    arrays = {
        "rows": rng.normal(size=(5, 3)),
        "columns": np.asfortranarray(rng.normal(size=(5, 3))),
        "swapped": rng.normal(size=4).astype(">f4"),
        "counts": np.arange(6, dtype=np.uint16).reshape(1, 2, 3),
        "words": np.array(["speed", "é"]),
        "none": np.empty((0, 3)),
        "single": np.array(2.5),
    }
    np.savez_compressed(tmp_path / "all.npz", **arrays)  # type: ignore[arg-type]  # its stubs take the arrays for allow_pickle
    read = read_arrays(tmp_path / "all.npz", NETWORK_FILE)
    for name, array in arrays.items():
        np.save(tmp_path / "one.npy", array)
        for copy in (read[name], read_array(tmp_path / "one.npy")):
            assert copy.dtype == array.dtype
            np.testing.assert_array_equal(copy, array)


ARCHIVES = {
    "bomb": (
        archive_of({"W0.npy": bytes(100_000_000)}),
        "unpacks to 100 MB: a trained network must have at most 16 MB",
    ),
    "understated bomb": (understated(50_000_000), "damaged"),
    "encrypted": (encrypted(archive_of({"W0.npy": b"secret"})), "is encrypted"),
    "other method": (archive_of({"W0.npy": bytes(1000)}, zipfile.ZIP_LZMA), "unusual method"),
    "members": (archive_of({f"m{k}": b"" for k in range(MAX_MEMBERS + 1)}), "has 1001 members"),
    "cut off": (archive_of({"W0.npy": bytes(range(256)) * 40})[:-40], "damaged"),
    "compressed text": (zlib.compress(bytes(10_000)), "damaged or of another kind"),
    "empty": (b"", "damaged or of another kind"),
}


@pytest.mark.parametrize("case", ARCHIVES)
def test_an_archive_that_is_damaged_or_unpacks_to_too_much_is_refused(case: str, tmp_path: Path) -> None:
    content, words = ARCHIVES[case]
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(ValueError, match=rf"^[^\n]*a\.npz[^\n]*{words}[^\n]*$"):
        read_archive(tmp_path / "a.npz", NETWORK_FILE)


def test_a_damaged_byte_of_a_member_is_noticed(tmp_path: Path) -> None:
    content = bytearray(archive_of({"W0.npy": bytes(range(256))}, zipfile.ZIP_STORED))
    content[100] ^= 0xFF
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(ValueError, match="damaged"):
        read_archive(tmp_path / "a.npz", NETWORK_FILE)


@pytest.mark.parametrize("name", ["heights.csv.gz", "heights.csv.bz2"])
def test_a_compressed_height_map_is_refused(name: str, tmp_path: Path) -> None:
    """Numpy's reader unpacks such files without a limit."""
    import bz2
    import gzip

    text = b"1,2,3,4\n" * 4
    (tmp_path / name).write_bytes(gzip.compress(text) if name.endswith("gz") else bz2.compress(text))
    with pytest.raises(ValueError, match=f"{name}: not a"):
        load_height_map(str(tmp_path / name), 0.5)


@pytest.mark.parametrize("text", ["", "# only a comment\n", "\n\n", "1,2\n3\n", "a" * 5000, "1;2;3;4\n" * 4])
def test_a_text_without_a_table_of_heights_is_refused_in_one_short_line(text: str, tmp_path: Path) -> None:
    (tmp_path / "heights.csv").write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=r"^[^\n]*heights\.csv: not a table of heights[^\n]{1,200}$"):
        load_height_map(str(tmp_path / "heights.csv"), 0.5)
