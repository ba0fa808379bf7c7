"""``python -m offtrack``: the command line."""

from __future__ import annotations

from scenarios.cli import main

main()
