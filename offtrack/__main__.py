"""``python -m offtrack``: the command line."""

from __future__ import annotations

from offtrack.commands.cli import main

main()
