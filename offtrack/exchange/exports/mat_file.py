"""Logs as MATLAB's MAT files of version 5."""

from pathlib import Path
from typing import Any, ClassVar, Final

from offtrack.exchange.exports.catalogue import TIME, ExportedRun, by_rows, plain_names
from scenarios.results.run_directory import check_new_file, replacing

_LONGEST: Final = 63  # characters of a name in MATLAB
_HEADER: Final = b"MATLAB 5.0 MAT-file, written by offtrack".ljust(116)  # in place of scipy's, which has the time


class Mat:
    """Structures ``signals``, ``units``, ``meanings`` and ``names``, whose fields are the signals' names made plain.

    ``names`` holds the original ones. Signals have a row for each 10 ms. Those without a value in some rows are also in
    the structure ``sampled``: each with ``time`` and ``value`` where it has one.
    """

    file: ClassVar = "signals.mat"
    takes_images: ClassVar = False

    @staticmethod
    def write(run: ExportedRun, path: Path) -> tuple[Path, ...]:
        """Write the file."""
        from scipy.io import savemat

        check_new_file(path)
        log, plain = run.log, plain_names(run.log.names, _LONGEST)
        content: dict[str, Any] = {
            "signals": {plain[name]: log[name][:, None] for name in log.names},
            "units": {plain[signal.name]: signal.unit for signal in log.signals},
            "meanings": {plain[signal.name]: signal.description for signal in log.signals},
            "names": {plain[name]: name for name in log.names},
            "sampled": {
                plain[name]: {TIME: log[TIME][rows, None], "value": log[name][rows, None]}
                for rows, names in by_rows(log)
                for name in names
                if not rows.all()
            },
        }
        with replacing(path) as unfinished:
            savemat(str(unfinished), content, appendmat=False, long_field_names=True, do_compression=True)
            with unfinished.open("r+b") as file:
                file.write(_HEADER)
        return (path,)
