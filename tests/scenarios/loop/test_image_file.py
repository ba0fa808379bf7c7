"""Images that a user gives: only pictures are decoded, only to a limit, and nothing else happens."""

import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from scenarios.image_file import pixel_size, read_grey, read_grey_upright

READERS: tuple[Callable[[Path], object], ...] = (pixel_size, read_grey, read_grey_upright)
COLOURS = np.random.default_rng(5).integers(0, 256, (24, 36, 3), dtype=np.uint8)
POSTSCRIPT = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 8\n%%EndComments\nshowpage\n"


def png_header(width: int, height: int) -> bytes:
    """A PNG file of that size without content, correct as far as it goes."""
    header = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    chunks = [header, b"IDAT" + zlib.compress(b""), b"IEND"]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk)) for chunk in chunks
    )


@pytest.mark.parametrize("read", READERS)
def test_postscript_under_the_name_of_an_image_is_not_run(
    read: Callable[[Path], object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A Ghostscript that leaves a trace is first on the path."""
    trace = tmp_path / "was here"
    (tmp_path / "gs").write_text(f"#!/bin/sh\ntouch '{trace}'\n")
    (tmp_path / "gs").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setattr("PIL.EpsImagePlugin.gs_binary", None)
    (tmp_path / "image.png").write_bytes(POSTSCRIPT)
    with pytest.raises(ValueError, match=r"image\.png is corrupt or not an image$"):
        read(tmp_path / "image.png")
    assert not trace.exists()


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize("size", [(60_000, 60_000), (8_001, 8_000), (64_000_001, 1)])
def test_more_than_64_megapixels_are_refused_before_they_are_decoded(
    read: Callable[[Path], object], size: tuple[int, int], tmp_path: Path
) -> None:
    (tmp_path / "big.png").write_bytes(png_header(*size))
    limit = f"big.png has {size[0]}x{size[1]} px: an image must have at most 64 megapixels; reduce it$"
    with pytest.raises(ValueError, match=limit):
        read(tmp_path / "big.png")


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.bmp", "a.tif", "a.ppm", "grey.png", "grey.jpg", "grey.pgm"])
def test_good_images_have_the_pixels_that_the_libraries_decode(name: str, tmp_path: Path) -> None:
    """Not a bit differs from reading the file with Pillow or OpenCV alone."""
    path = tmp_path / name
    cv2.imwrite(str(path), COLOURS[..., 0] if name.startswith("grey") else COLOURS)
    assert pixel_size(path) == (36, 24)
    with Image.open(path) as image:
        np.testing.assert_array_equal(read_grey(path), np.asarray(image.convert("L")))
    np.testing.assert_array_equal(read_grey_upright(path), cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))


def test_a_photograph_is_turned_as_its_exif_data_say(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6  # orientation: a quarter turn
    Image.fromarray(COLOURS).save(tmp_path / "a.jpg", exif=exif)
    assert read_grey_upright(tmp_path / "a.jpg").shape == (36, 24)


@pytest.mark.parametrize("name", ["a.png", "grey.png", "a.jpg", "a.tif", "a.bmp"])
def test_damage_is_one_line_and_libraries_in_c_stay_silent(
    name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Every 7th byte is flipped in turn, and the file is cut off: it is read or refused, and nothing is printed."""
    path = tmp_path / name
    cv2.imwrite(str(path), COLOURS[:12, :18, 0] if name.startswith("grey") else COLOURS[:12, :18])
    whole = path.read_bytes()
    damaged = [whole[:k] + bytes([whole[k] ^ 0xFF]) + whole[k + 1 :] for k in range(0, len(whole), 7)]
    refusals = []
    for content in (*damaged, *(whole[:k] for k in range(0, len(whole), 50))):
        path.write_bytes(content)
        for read in (read_grey, read_grey_upright):
            try:
                read(path)
            except ValueError as error:
                refusals.append(str(error))
    assert len(refusals) > len(damaged) / 20
    assert not [line for line in refusals if "\n" in line or not line.startswith(str(path))]
    printed = capfd.readouterr()
    assert (printed.out, printed.err) == ("", "")


@pytest.mark.parametrize("side", [8, 0])
def test_a_whole_file_without_rows_is_corrupt(tmp_path: Path, capfd: pytest.CaptureFixture[str], side: int) -> None:
    (tmp_path / "a.png").write_bytes(png_header(side, side))
    with pytest.raises(ValueError, match=r"a\.png is corrupt or not an image$"):
        read_grey(tmp_path / "a.png")
    assert "zero" not in capfd.readouterr().err  # a line of the library


def test_pixels_as_text_are_refused(tmp_path: Path) -> None:
    """64 megapixels of them take more than a minute."""
    (tmp_path / "a.pgm").write_text("P2\n2 2 255\n1 2 3 4\n")
    with pytest.raises(ValueError, match="save it in a binary format"):
        read_grey(tmp_path / "a.pgm")


def test_a_missing_image_is_missing(tmp_path: Path) -> None:
    for read in READERS:
        with pytest.raises(ValueError, match=r"none\.png is missing$"):
            read(tmp_path / "none.png")
