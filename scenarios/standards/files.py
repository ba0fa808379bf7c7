"""Result directory of an assessment: report, numbers, and the log of every manoeuvre."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from scenarios.drawings.files import Format
from scenarios.results.log import write_log
from scenarios.results.run_directory import appearing_at_once
from scenarios.standards.assessment import AssessmentMatrix
from scenarios.standards.assessment_page import assessment_page
from scenarios.standards.manoeuvre_drawings import write_drawings


def write_assessment(assessment: AssessmentMatrix, directory: Path, drawings: Sequence[Format] = ()) -> None:
    """Write ``report.html``, ``assessment.json`` and ``<manoeuvre>.parquet``; the directory appears complete.

    With several cases the logs are ``<load>-<hand>-<manoeuvre>.parquet``. Drawings have the same names as the logs.

    Raises:
        ValueError: if the directory exists and is not empty.
    """
    with appearing_at_once(directory) as folder:
        (folder / "report.html").write_text(assessment_page(assessment), encoding="utf-8")
        (folder / "assessment.json").write_text(json.dumps(assessment.summary(), indent=2) + "\n", encoding="utf-8")
        for case in assessment.cases:
            before = f"{case.load}-{case.conditions.hand}-" if len(assessment.cases) > 1 else ""
            for manoeuvre in case.manoeuvres:
                write_log(manoeuvre.log, folder / f"{before}{manoeuvre.key}.parquet")
            write_drawings(case, folder, before, drawings)
