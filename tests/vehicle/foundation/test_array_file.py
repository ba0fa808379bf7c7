"""Arrays and archives that a user gives: nothing is unpacked or allocated that the file does not justify."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest

from controllers.trailer_steering.policy import NETWORK_FILE
from vehicle.foundation.data_file import read_archive, read_array, read_arrays
from vehicle.foundation.user_file import MAX_MEMBERS
from vehicle.rover.terrain import load_height_map


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
