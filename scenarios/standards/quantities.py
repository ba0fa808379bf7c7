"""Quantities measured in the standard manoeuvres: their labels, units and meanings by name."""

from __future__ import annotations

from typing import Final

from scenarios.report.numbers import groups

BY_NAME: Final = groups()["assessment"].numbers
