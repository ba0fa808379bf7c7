"""Random streams: one integer seed per run, one named stream per consumer."""

from zlib import crc32

import numpy as np


def stream(seed: int, name: str) -> np.random.Generator:
    """Random stream of a run by name; another consumer does not change it."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(crc32(name.encode()),)))
