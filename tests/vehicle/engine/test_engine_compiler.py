"""Compiled code is kept, and what is picked up is always what the source says."""

import os
import re
import stat
from pathlib import Path

import pytest

from vehicle.engine import compiler
from vehicle.foundation.user_cache import warn_once

SOURCE = "int answer(void) { return ANSWER; }"


@pytest.fixture
def gcc(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> compiler.Compiler:
    found = compiler.compiler()
    if found is None:
        pytest.skip("no C compiler here")
    monkeypatch.setenv("OFFTRACK_CACHE", str(tmp_path / "cache"))
    warn_once.cache_clear()
    return found


def kept(tmp_path: Path) -> list[Path]:
    return sorted((tmp_path / "cache").iterdir())


def test_a_library_is_compiled_once(gcc: compiler.Compiler, tmp_path: Path) -> None:
    assert compiler.library(SOURCE, ["ANSWER=1"], gcc).answer() == 1
    (made,) = kept(tmp_path)
    age = made.stat().st_mtime_ns
    assert compiler.library(SOURCE, ["ANSWER=1"], gcc).answer() == 1
    assert [path.stat().st_mtime_ns for path in kept(tmp_path)] == [age]


def test_each_source_macro_flag_and_compiler_has_its_own(gcc: compiler.Compiler, tmp_path: Path) -> None:
    """All that a library was made from is in its name: nothing made from something else can be picked up."""
    other = "int answer(void) { return 2 * ANSWER; }"
    assert compiler.library(SOURCE, ["ANSWER=1"], gcc).answer() == 1
    assert compiler.library(other, ["ANSWER=1"], gcc).answer() == 2
    assert compiler.library(SOURCE, ["ANSWER=3"], gcc).answer() == 3
    assert compiler.library(SOURCE, ["ANSWER=1"], gcc._replace(flags=(*gcc.flags, "-O1"))).answer() == 1
    assert compiler.library(SOURCE, ["ANSWER=1"], gcc._replace(identity="a later version")).answer() == 1
    assert len(kept(tmp_path)) == 5


@pytest.mark.parametrize("content", [b"", b"cut short", None])
def test_a_damaged_or_exchanged_file_is_made_anew(
    gcc: compiler.Compiler, tmp_path: Path, caplog: pytest.LogCaptureFixture, content: bytes | None
) -> None:
    """After a full disk, or with another library's content under its name, a file is not believed."""
    compiler.library(SOURCE, ["ANSWER=5"], gcc)
    (wrong,) = kept(tmp_path)
    compiler.library(SOURCE, ["ANSWER=6"], gcc)
    (right,) = (path for path in kept(tmp_path) if path != wrong)
    good = wrong.read_bytes()
    wrong.write_bytes(right.read_bytes() if content is None else content)
    assert compiler.library(SOURCE, ["ANSWER=5"], gcc).answer() == 5
    assert wrong.read_bytes() == good
    (warning,) = caplog.messages
    assert re.match(rf"offtrack: the cache is not used.*{wrong} is damaged", warning)


def test_a_folder_that_others_may_write_is_not_used(
    gcc: compiler.Compiler, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Nothing is read from it or written to it."""
    compiler.library(SOURCE, ["ANSWER=5"], gcc)
    before = kept(tmp_path)
    (tmp_path / "cache").chmod(0o777)
    assert compiler.library(SOURCE, ["ANSWER=5"], gcc).answer() == 5
    assert compiler.library(SOURCE, ["ANSWER=6"], gcc).answer() == 6
    (warning,) = caplog.messages
    assert f"{tmp_path / 'cache'} is open to other users (mode 777). Set OFFTRACK_CACHE" in warning
    assert before == kept(tmp_path)


def test_the_files_of_another_user_are_not_used(
    gcc: compiler.Compiler, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    compiler.library(SOURCE, ["ANSWER=5"], gcc)
    somebody = os.geteuid() + 1000
    monkeypatch.setattr(os, "geteuid", lambda: somebody)
    assert compiler.library(SOURCE, ["ANSWER=5"], gcc).answer() == 5
    (warning,) = caplog.messages
    assert re.search(r" belongs to user \d+, not to you \(user \d+\). Set OFFTRACK_CACHE to a folder", warning)


def test_whatever_the_umask_the_cache_is_private(
    gcc: compiler.Compiler, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Otherwise it would refuse itself the next time."""
    before = os.umask(0)
    try:
        for _ in range(2):
            assert compiler.library(SOURCE, ["ANSWER=5"], gcc).answer() == 5
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "cache").stat().st_mode) == 0o700
    assert caplog.messages == []


def test_what_killed_builds_left_is_removed(gcc: compiler.Compiler, tmp_path: Path) -> None:
    """After an hour; a file that is being written stays."""
    folder = tmp_path / "cache"
    folder.mkdir(mode=0o700)
    for name in ("build-old", "build-new"):
        (folder / name).touch()
    os.utime(folder / "build-old", (0.0, 0.0))
    compiler.library(SOURCE, ["ANSWER=5"], gcc)
    assert [path.name for path in kept(tmp_path) if path.suffix != ".so"] == ["build-new"]


def test_without_memory_files_a_library_is_loaded_from_a_private_folder(
    gcc: compiler.Compiler, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some systems forbid code from memory."""

    def forbidden(name: str) -> int:
        raise PermissionError(name)

    monkeypatch.setattr(os, "memfd_create", forbidden)
    assert [compiler.library(SOURCE, [f"ANSWER={k}"], gcc).answer() for k in (1, 2)] == [1, 2]


def test_a_cache_that_can_not_be_written_does_no_harm(
    gcc: compiler.Compiler, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file in the way stands for a home directory that is full or read-only: the code is kept for this run alone."""
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("OFFTRACK_CACHE", str(tmp_path / "file" / "cache"))
    assert compiler.library(SOURCE, ["ANSWER=8"], gcc).answer() == 8


def test_what_the_compiler_refuses_is_told(gcc: compiler.Compiler, tmp_path: Path) -> None:
    with pytest.raises(compiler.CompilerError, match=r"^gcc [\d.]+ failed: .*error") as refusal:
        compiler.library("int answer(void) { return }", [], gcc)
    assert "\n" not in str(refusal.value)
    assert not (tmp_path / "cache").exists() or kept(tmp_path) == []


@pytest.mark.usefixtures("gcc")
def test_a_kernel_that_is_not_compiled_is_told(caplog: pytest.LogCaptureFixture) -> None:
    assert compiler.kernel("estimators.odometry", "pose.c", "refine", ("rows=",)) is None
    assert "offtrack: pose.c is not compiled, slower code takes its place: gcc" in caplog.text


@pytest.mark.parametrize("words", ["ccache gcc", "'{folder}/ccache' gcc -m64", "{folder}/my ccache"])
def test_the_compiler_is_a_command_as_in_cc(
    words: str, gcc: compiler.Compiler, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A program before the compiler's name, flags after it; a path with a space is one word."""
    for name, call in (("ccache", 'exec "$@"'), ("my ccache", 'exec gcc "$@"')):
        (tmp_path / name).write_text(f"#!/bin/sh\n{call}\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.setenv("OFFTRACK_COMPILER", words.format(folder=tmp_path))
    found = compiler.compiler()
    assert found is not None
    assert found.name == gcc.name
    assert compiler.library(SOURCE, ["ANSWER=9"], found).answer() == 9


@pytest.mark.parametrize(
    ("wanted", "reason"),
    [
        ("NONE", "OFFTRACK_COMPILER is none"),
        ("nobody-has-it", "OFFTRACK_COMPILER = nobody-has-it is no C compiler"),
        ("gcc 'open", "OFFTRACK_COMPILER = gcc 'open is no C compiler"),
        (" ", "OFFTRACK_COMPILER =   is no C compiler"),
    ],
)
def test_no_compiler_is_none(
    wanted: str, reason: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A compiler that is switched off or missing counts as none; one line says what that costs and what to do."""
    monkeypatch.setenv("OFFTRACK_COMPILER", wanted)
    warn_once.cache_clear()
    assert compiler.compiler() is None
    assert compiler.engine_name() == f"interpreted ({reason})"
    compiler.warn_if_interpreted()
    compiler.warn_if_interpreted()
    (warning,) = caplog.messages
    assert warning.startswith(f"offtrack: vehicle models are interpreted ({reason}): each of their steps takes about 5")
    assert "Install gcc or clang" in warning


def test_the_engine_names_its_compiler(gcc: compiler.Compiler) -> None:
    """With the version, which clang gives along with that of an old gcc."""
    assert compiler.engine_name() == f"compiled by {gcc.name}"
    macros = "#define __GNUC__ 4\n#define __GNUC_MINOR__ 2\n#define __GNUC_PATCHLEVEL__ 1\n"
    assert compiler.Compiler("/usr/bin/cc", (), macros).name == "gcc 4.2.1"
    own = "".join(f"#define __clang_{part}__ {n}\n" for part, n in (("major", 14), ("minor", 0), ("patchlevel", 6)))
    assert compiler.Compiler("/usr/bin/cc", (), macros + own).name == "clang 14.0.6"
    assert compiler.Compiler("/opt/tcc", (), "").name == "/opt/tcc"
