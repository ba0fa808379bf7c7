"""Physics, and the words everything else is written in (frames, clock)."""
