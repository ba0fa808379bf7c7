"""Truth in, stamped messages out; nothing else sees the truth."""
