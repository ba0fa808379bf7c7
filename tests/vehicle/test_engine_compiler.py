"""Compiled code is kept, and what is picked up is always what the source says."""

from __future__ import annotations

import multiprocessing
import subprocess
import sys
from pathlib import Path

import pytest

from vehicle.engine.compiler import Compiler, CompilerError, compiler, library

SOURCE = "int answer(void) { return ANSWER; }"


@pytest.fixture
def gcc(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Compiler:
    monkeypatch.setenv("OFFTRACK_CACHE", str(tmp_path / "cache"))
    found = compiler()
    if found is None:
        pytest.skip("no C compiler here")
    return found


def kept(tmp_path: Path) -> list[Path]:
    return sorted((tmp_path / "cache").iterdir())


def test_a_library_is_compiled_once(gcc: Compiler, tmp_path: Path) -> None:
    """The second time nothing is written: the file is the same, and so is its age."""
    assert library(SOURCE, ["ANSWER=1"], gcc).answer() == 1
    (made,) = kept(tmp_path)
    age = made.stat().st_mtime_ns
    assert library(SOURCE, ["ANSWER=1"], gcc).answer() == 1
    assert [path.stat().st_mtime_ns for path in kept(tmp_path)] == [age]


def test_each_source_macro_flag_and_compiler_has_its_own(gcc: Compiler, tmp_path: Path) -> None:
    """All that a library was made from is in its name: nothing made from something else can be picked up."""
    other = "int answer(void) { return 2 * ANSWER; }"
    assert library(SOURCE, ["ANSWER=1"], gcc).answer() == 1
    assert library(other, ["ANSWER=1"], gcc).answer() == 2
    assert library(SOURCE, ["ANSWER=3"], gcc).answer() == 3
    assert library(SOURCE, ["ANSWER=1"], gcc._replace(flags=(*gcc.flags, "-O1"))).answer() == 1
    assert library(SOURCE, ["ANSWER=1"], gcc._replace(identity="a later version")).answer() == 1
    assert len(kept(tmp_path)) == 5


@pytest.mark.parametrize("content", [b"", b"cut short", None])
def test_a_damaged_or_exchanged_file_is_made_anew(gcc: Compiler, tmp_path: Path, content: bytes | None) -> None:
    """A name says what is inside: after a full disk, or with another library's content, it is not believed."""
    library(SOURCE, ["ANSWER=5"], gcc)
    (wrong,) = kept(tmp_path)
    library(SOURCE, ["ANSWER=6"], gcc)
    (right,) = (path for path in kept(tmp_path) if path != wrong)
    damaged = right.read_bytes() if content is None else content
    wrong.unlink()  # not written in place: this process has it open
    wrong.write_bytes(damaged)
    script = f"from vehicle.engine.compiler import *; print(library({SOURCE!r}, ['ANSWER=5'], compiler()).answer())"
    elsewhere = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert elsewhere.stdout == "5\n"
    assert wrong.read_bytes() != damaged


def answer_of_a_slow_source() -> int:
    found = compiler()
    assert found is not None
    waits = SOURCE + "\n" + "\n".join(f"double f{k}(double x) {{ return x * {k}; }}" for k in range(2000))
    answer: int = library(waits, ["ANSWER=7"], found).answer()
    return answer


def test_two_processes_at_once_are_safe(gcc: Compiler, tmp_path: Path) -> None:
    """Both compile, under names of their own; whoever is last replaces the whole file in one go."""
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        results = [pool.apply_async(answer_of_a_slow_source) for _ in range(2)]
        assert [result.get(timeout=60.0) for result in results] == [7, 7]
    assert all(path.suffix == ".so" for path in kept(tmp_path))


def test_a_cache_that_can_not_be_written_does_no_harm(
    gcc: Compiler, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file in the way stands for a home directory that is full or read-only: the code is kept for this run alone."""
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("OFFTRACK_CACHE", str(tmp_path / "file" / "cache"))
    assert library(SOURCE, ["ANSWER=8"], gcc).answer() == 8


def test_what_the_compiler_refuses_is_told(gcc: Compiler, tmp_path: Path) -> None:
    """With its own words; and nothing is left behind."""
    with pytest.raises(CompilerError, match="error"):
        library("int answer(void) { return }", [], gcc)
    assert kept(tmp_path) == []


@pytest.mark.parametrize("wanted", ["none", "NONE", "a-compiler-that-nobody-has"])
def test_no_compiler_is_none(wanted: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A compiler that is switched off or missing counts as none."""
    monkeypatch.setenv("OFFTRACK_COMPILER", wanted)
    assert compiler() is None
