"""Folders of images become frames with the right times, or are refused in one line that says what to do."""

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
import pytest

from offtrack.exchange.recordings.layouts.folders import FOLDERS, find_sequence
from offtrack.exchange.recordings.stereo_sequence import Dropped, Folders, image_size, stream
from scenarios.image_file import read_grey
from sensors.messages import GreyImage

SIZE = (24, 16)  # width, height [px]


def image(seed: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, size[::-1], dtype=np.uint8)


def write_images(folder: Path, names: Iterable[str], size: tuple[int, int] = SIZE) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for k, name in enumerate(names):
        assert cv2.imwrite(str(folder / name), image(k, size))


def make(directory: Path, numbers: Iterable[int], folders: Folders = FOLDERS[0], kind: str = "png") -> Path:
    numbers = list(numbers)
    for folder in folders[:2]:
        write_images(directory / folder, [f"{n:06d}.{kind}" for n in numbers])
    return directory


def write_times(directory: Path, times: Iterable[float | str]) -> None:
    (directory / "times.txt").write_text("".join(f"{t}\n" for t in times), encoding="utf-8")


@pytest.mark.parametrize("folders", FOLDERS, ids=[folders.left for folders in FOLDERS])
@pytest.mark.parametrize("kind", ["png", "jpg", "pgm"])
def test_every_layout_and_format_is_found(tmp_path: Path, folders: Folders, kind: str) -> None:
    write_times(make(tmp_path, range(3), folders, kind), [7.0, 7.1, 7.25])
    sequence = find_sequence(tmp_path)
    assert sequence.folders == folders
    assert [f.tick for f in sequence.frames] == [0, 100, 250]
    assert [f.time for f in sequence.frames] == [7.0, 7.1, 7.25]
    assert [(f.left.name, f.right.name) for f in sequence.frames] == [(f"{k:06d}.{kind}",) * 2 for k in range(3)]
    assert image_size(sequence) == SIZE


def test_the_grey_pair_goes_before_the_colour_pair_and_a_rate_takes_the_place_of_times(tmp_path: Path) -> None:
    """KITTI has both of each frame; at 20 Hz there is a frame every 50 ticks, whatever times.txt says."""
    make(tmp_path, range(4), FOLDERS[1])
    (tmp_path / "image_0").mkdir()  # half a pair
    assert find_sequence(tmp_path, 20.0).folders.left == "image_2"
    write_times(make(tmp_path, range(4), FOLDERS[0]), ["nonsense"])
    sequence = find_sequence(tmp_path, 20.0)
    assert sequence.folders.left == "image_0"
    assert [f.tick for f in sequence.frames] == [0, 50, 100, 150]


@pytest.mark.parametrize(
    "names",
    [
        [[f"{side}_{n:04d}.png" for n in (1, 2, 10)] for side in ("left", "right")],
        [[f"{1403636579763555584 + 50_000_000 * k}.png" for k in range(3)]] * 2,
    ],
    ids=["numbers", "time stamps"],
)
def test_names_of_the_two_cameras_are_paired_by_their_number_or_their_order(
    tmp_path: Path, names: list[list[str]]
) -> None:
    """left_0001.png belongs to right_0001.png; nanoseconds leave gaps between all numbers, which miss no frame."""
    for side, files in zip(("left", "right"), names, strict=True):
        write_images(tmp_path / side, files)
    frames = find_sequence(tmp_path, 10.0).frames
    assert [[getattr(f, side).name for f in frames] for side in ("left", "right")] == names


def test_a_number_without_images_is_a_frame_that_is_missing(tmp_path: Path) -> None:
    write_times(make(tmp_path, [0, 1, 3]), [0.0, 0.1, 0.2, 0.3])
    frames = find_sequence(tmp_path).frames
    assert [f.tick for f in frames] == [0, 100, 200, 300]
    read = [frame for _, frame in stream(frames, SIZE)]
    assert [isinstance(frame, Dropped) for frame in read] == [False, False, True, False]
    assert read[2] == Dropped(f"{tmp_path}/image_0/000002.png is missing")


@pytest.mark.parametrize(
    ("numbers", "count", "period", "frames", "note"),
    [
        ([0, 2, 4], 3, 0.2, [("000000", 0, 0), ("000002", 200, 1), ("000004", 400, 2)], ""),  # every second image
        ([5, 6, 7], 10, 0.1, [("000005", 0, 5), ("000006", 100, 6), ("000007", 200, 7)], "10 lines"),  # a piece
        ([0, 1, 2, 3], 3, 0.1, [("000000", 0, 0), ("000001", 100, 1), ("000002", 200, 2)], "last frame"),  # cut off
    ],
)
def test_frames_find_their_lines_of_times(
    tmp_path: Path, numbers: list[int], count: int, period: float, frames: list[tuple[str, int, int]], note: str
) -> None:
    """Of fewer images, of a piece of a longer sequence, and where an interrupted writer left images without a time."""
    write_times(make(tmp_path, numbers), [period * k for k in range(count)])
    if note == "last frame":
        (tmp_path / "image_1" / "000003.png").unlink()
    sequence = find_sequence(tmp_path)
    assert [(frame.left.stem, frame.tick, frame.line) for frame in sequence.frames] == frames
    assert [frame.time for frame in sequence.frames] == pytest.approx([period * line for _, _, line in frames])
    assert note in " ".join(sequence.notes)


def test_a_pause_is_noted_and_hidden_files_are_no_images(tmp_path: Path) -> None:
    """Such files are those of another system on its disks."""
    write_times(make(tmp_path, range(4)), [0.0, 0.1, 0.2, 60.0])
    (tmp_path / "image_0" / "._000000.png").write_bytes(b"\0\5\x16\7")
    sequence = find_sequence(tmp_path)
    assert len(sequence.frames) == 4
    assert sequence.notes == ("no images for 59.8 s after 000002.png: are the times right?",)


@pytest.mark.parametrize(
    ("times", "names", "says"),
    [
        (None, "", "times.txt is missing: create it with the time [s] of every frame, or use --rate HZ"),
        ([0.0, 0.1], "", "has 2 lines for 4 frames"),
        ([0.1 * k for k in range(6)], "abcd", "has 6 lines for 4 frames"),  # no numbers: any could belong to any
        ([0.0, 0.1, 0.1, 0.2], "", "line 3: 0.1 s must be at least 0.001 s after the line before"),
        ([0.0, 0.1, 0.05, 0.2], "", "line 3"),
        ([0.0, "later", 0.2, 0.3], "", "line 2: 'later' is not a time"),
        ([0.0, "nan", 0.2, 0.3], "", "line 2: nan is not a time"),
        ([0.0, 0.1, 0.2, 1e300], "", "line 4: 1e+300 is not a time"),
        ([0.0, 1e5, 2e5, 3e5], "", "Times must be in seconds"),
        (["0000", "0001", "0002", "0003"], "", "counts the frames from 0 on"),
    ],
)
def test_wrong_times_are_refused(tmp_path: Path, times: list[float | str] | None, names: str, says: str) -> None:
    for side in ("left", "right"):
        write_images(tmp_path / side, [f"{name}.png" for name in names or "0123"])
    if times is not None:
        write_times(tmp_path, times)
    with pytest.raises(ValueError, match=r"^[^\n]*times\.txt[^\n]*$") as refused:
        find_sequence(tmp_path)
    assert says in str(refused.value)
    assert "--rate" in str(refused.value) or "is not a time" in str(refused.value)


@pytest.mark.parametrize("rate", [0.0, -1.0, 2000.0, float("nan")])
def test_a_rate_that_can_not_be_is_refused(tmp_path: Path, rate: float) -> None:
    make(tmp_path, range(2))
    with pytest.raises(ValueError, match="--rate"):
        find_sequence(tmp_path, rate)


def test_a_folder_without_images_is_named(tmp_path: Path) -> None:
    write_images(tmp_path / "image_0", ["000000.png"])
    (tmp_path / "image_1").mkdir()
    with pytest.raises(ValueError, match=r"image_1 contains no images"):
        find_sequence(tmp_path)


def test_images_that_are_no_pairs_are_refused_before_anything_is_estimated(tmp_path: Path) -> None:
    write_images(tmp_path / "a" / "left", ["0.png"])
    write_images(tmp_path / "a" / "right", ["0.png"], (12, 8))
    with pytest.raises(ValueError, match=r"right/0\.png has 12x8 px and .*left/0\.png 24x16 px"):
        image_size(find_sequence(tmp_path / "a", 10.0))
    for side in ("left", "right"):
        (tmp_path / "b" / side).mkdir(parents=True)
        (tmp_path / "b" / side / "0.png").write_text("no image", encoding="utf-8")
    with pytest.raises(ValueError, match=r"no pair of images can be read.*left/0\.png is corrupt or not an image"):
        image_size(find_sequence(tmp_path / "b", 10.0))


def test_broken_images_are_dropped_with_the_reason_and_the_rest_is_read(tmp_path: Path) -> None:
    """Cut off, empty, with flipped bits, of another size: each is one frame less, and its file is named."""
    left = make(tmp_path, range(12)) / "image_0"
    whole = (left / "000003.png").read_bytes()
    middle = len(whole) // 2
    flipped = whole[:middle] + bytes([whole[middle] ^ 0xFF]) + whole[middle + 1 :]
    for k, content in ((3, whole[:middle]), (4, b""), (5, flipped)):
        (left / f"{k:06d}.png").write_bytes(content)
    write_images(tmp_path / "image_1", ["000006.png"], (12, 8))
    read = [frame for _, frame in stream(find_sequence(tmp_path, 10.0).frames, SIZE)]
    reasons = {k: frame.reason for k, frame in enumerate(read) if isinstance(frame, Dropped)}
    assert sorted(reasons) == [3, 4, 5, 6]
    for k in (3, 4, 5):
        assert reasons[k] == f"{left}/{k:06d}.png is corrupt or not an image"
    assert reasons[6] == f"{tmp_path}/image_1/000006.png has 12x8 px, not 24x16"
    whole_frame = read[11]
    assert not isinstance(whole_frame, Dropped)
    np.testing.assert_array_equal(whole_frame.left, image(11))
    assert whole_frame.tick == 1100


def test_a_truncated_jpeg_is_broken_not_half_grey(tmp_path: Path) -> None:
    """Decoders fill what is missing: an odometry would follow the edge of the filling."""
    big = (320, 240)
    write_images(tmp_path, ["a.jpg"], big)
    data = (tmp_path / "a.jpg").read_bytes()
    (tmp_path / "a.jpg").write_bytes(data[: len(data) // 2])
    with pytest.raises(ValueError, match=r"a\.jpg is corrupt or not an image"):
        read_grey(tmp_path / "a.jpg")


def test_colour_and_16_bits_become_8_bits_of_grey(tmp_path: Path) -> None:
    """Luminance by the weights of ITU-R BT.601, within the one level that rounding may cost; 16 bits by the upper 8."""
    grey = image(1)
    colour = np.random.default_rng(2).integers(0, 256, (*SIZE[::-1], 3), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "c.png"), colour)
    expected = cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY)
    assert np.abs(read_grey(tmp_path / "c.png").astype(int) - expected).max() <= 1
    for kind in ("png", "pgm"):
        cv2.imwrite(str(tmp_path / f"d.{kind}"), grey.astype(np.uint16) * 257)
        np.testing.assert_array_equal(read_grey(tmp_path / f"d.{kind}"), grey)


def test_only_a_few_frames_are_in_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After the first of 40 frames no more than some ten have been read."""
    make(tmp_path, range(40))
    read: list[Path] = []

    def counted(path: Path, bits: int) -> GreyImage:
        read.append(path)
        return read_grey(path, bits)

    monkeypatch.setattr("offtrack.exchange.recordings.stereo_sequence.read_grey", counted)
    frames = stream(find_sequence(tmp_path, 10.0).frames, SIZE)
    next(frames)
    frames.close()  # type: ignore[attr-defined]  # a generator
    assert 2 <= len(read) <= 20
