"""Corners in buckets."""

from __future__ import annotations

import numpy as np

from estimators.odometry.image_points import detect_corners


def test_corners_of_a_square_are_found() -> None:
    image = np.full((200, 300), 50, np.uint8)
    image[60:121, 80:181] = 180
    corners = detect_corners(image, per_bucket=4)
    expected = np.array([[79.5, 59.5], [180.5, 59.5], [79.5, 120.5], [180.5, 120.5]])  # edges of the pixels
    assert len(corners) == 4
    distance = np.linalg.norm(corners[:, None] - expected[None], axis=2)
    assert distance.min(axis=0).max() < 4.0  # [px] the tracker's window is 11


def test_no_bucket_holds_more_than_its_share() -> None:
    """Texture everywhere: every bucket of 50 x 50 px is full, none overflows."""
    image = np.random.default_rng(0).integers(0, 255, (200, 300), dtype=np.uint8)
    corners = detect_corners(image, per_bucket=3)
    _, counts = np.unique(corners // 50, axis=0, return_counts=True)
    assert len(counts) == 24
    assert counts.max() == 3
    assert counts.min() == 3


def test_strongest_corners_are_kept() -> None:
    image = np.full((100, 100), 100, np.uint8)
    image[20:24, 20:24] = 130
    image[20:24, 36:40] = 255
    corners = detect_corners(image, per_bucket=1)
    assert np.abs(corners - [37.5, 21.5]).max() < 3.0  # [px]


def test_darkness_and_its_noise_have_no_corners() -> None:
    """A black image has none, and neither has the sensor noise of 2 grey levels on a plain surface."""
    assert len(detect_corners(np.zeros((391, 1344), np.uint8), per_bucket=4)) == 0
    noise = 2.0 * np.random.default_rng(0).standard_normal((391, 1344))
    plain = np.clip(np.rint(120.0 + noise), 0, 255).astype(np.uint8)
    assert len(detect_corners(plain, per_bucket=4)) < 50  # a handful of coincidences in 216 buckets
