"""Recorded stereo images: read as a sequence, estimated from, compared with poses, and reported on."""
