"""The reader of files that a user names: regular, small enough, UTF-8, or one line."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any

import pytest

from tests.hostile_files import HOSTILE
from vehicle.foundation.user_file import MAX_NESTING, FileKind, full_path, read_bytes, read_text, read_toml

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
