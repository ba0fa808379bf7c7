"""Results of a campaign as JSON."""

from __future__ import annotations

import math
from typing import Any

from scenarios.campaigns.bisection import Search
from scenarios.campaigns.campaign import Campaign
from scenarios.campaigns.failures import Cell, Times, totals, unaccepted
from scenarios.campaigns.run_campaign import Results


def results_json(campaign: Campaign, found: Results) -> dict[str, Any]:
    """The results as JSON: infinite times, which never came, are "never"; those that do not apply are null."""
    broken = unaccepted(campaign, found.cells)
    return {
        "runs": len(found.runs),
        "cells": [_plain_cell(cell, accepted=cell not in broken) for cell in found.cells],
        "all_faults": [_plain_cell(cell, accepted=True) for cell in totals(found.cells)],
        "bisections": [_plain_search(search) for search in found.searches],
        "not_reached": sum(not run.reached for run in found.runs),
    }


def _plain_cell(cell: Cell, *, accepted: bool) -> dict[str, Any]:
    low, high = cell.failing.interval()
    worst = cell.worst
    return {
        "fault": cell.place[0],
        "further": cell.place[1],
        "law": cell.place[2],
        "failed": cell.failing.beyond,
        "runs": cell.failing.runs,
        "probability": [round(low, 6), round(high, 6)],
        "outcomes": dict(cell.endings),
        "detection_s": _plain_times(cell.detection),
        "recovery_s": _plain_times(cell.recovery),
        "worst": {"run": worst.outcome.case.title, "verdict": worst.verdict, "reasons": worst.reasons},
        "accepted": accepted,
    }


def _plain_times(times: Times) -> dict[str, Any]:
    known = {"median": times.median, "worst": times.worst}
    plain = {key: None if math.isnan(v) else "never" if math.isinf(v) else round(v, 3) for key, v in known.items()}
    return {**plain, "never": times.never, "runs": times.known}


def _plain_search(search: Search) -> dict[str, Any]:
    return {
        "fault": search.entry.title,
        "of": search.table.of,
        "law": search.law,
        "further": search.further,
        "seed": search.seed,
        "finding": search.finding,
        "smallest": search.bracket[1] if search.finding == "found" else None,
        "passes": search.bracket[0] if search.finding == "found" else None,
        "exceptions": list(search.exceptions),
    }
