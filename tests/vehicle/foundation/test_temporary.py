"""Temporary folders are gone at the end, also those of a process that was killed."""

import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from vehicle.foundation.temporary import PREFIX, temporary_folder

KILLED = """
import os
from vehicle.foundation.temporary import temporary_folder
with temporary_folder() as folder:
    (folder / "image.pgm").write_bytes(bytes(1000))
    os.kill(os.getpid(), 9)
"""


def test_folders_of_killed_processes_are_removed_by_the_next(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those in use, links and what others have named so stay."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    assert subprocess.run([sys.executable, "-c", KILLED], check=False).returncode == -9
    (left,) = tmp_path.iterdir()
    (tmp_path / "mine").mkdir()
    (tmp_path / f"{PREFIX}link").symlink_to(tmp_path / "mine")
    (tmp_path / f"{PREFIX}file").touch()
    with temporary_folder() as first, temporary_folder() as second:
        assert not left.exists()
        assert first.is_dir()
        assert second.is_dir()
    assert {path.name for path in tmp_path.iterdir()} == {"mine", f"{PREFIX}link", f"{PREFIX}file"}


def test_the_error_of_a_full_disk_names_the_folder_of_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A write that fails names nothing, and so would the one line that a user sees."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with pytest.raises(OSError, match=rf"No space left on device: '{tmp_path}'"), temporary_folder():
        Path("/dev/full").write_text("more", encoding="utf-8")
