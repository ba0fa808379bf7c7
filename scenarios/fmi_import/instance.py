"""An FMU in a run: it steps in time with the loop, from one call to the next."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from typing import Any

from scenarios.fmi_import.archive import FmuFile
from scenarios.fmi_import.mapping import FmuMap
from scenarios.fmi_import.process import FmuError, FmuProcess
from vehicle.clock import TICK


class FmuInstance:
    """An FMU with its map; copied with its state where it allows that.

    Time is its own, from 0 at the first call. A step takes the inputs of its beginning and gives the outputs of its
    end.
    """

    def __init__(self, fmu: FmuFile, links: FmuMap, parameters: Mapping[str, float | str]) -> None:
        """Create the instance.

        Args:
            fmu: the file.
            links: its map.
            parameters: start values that stand above those of the map, by name.

        Raises:
            ValueError: one line, if it can't be started.
        """
        self._fmu, self._map, self._given = fmu, links, {**links.parameters, **parameters}
        try:
            self._process = self._started()
        except FmuError as error:
            raise ValueError(str(error)) from None
        self.ticks = 0  # its own time

    def _started(self) -> FmuProcess:
        links = self._map
        inputs, outputs = [link.variable for link in links.inputs], [link.variable for link in links.outputs]
        return FmuProcess(self._fmu, inputs, outputs, self._given, links.timeout)

    @property
    def period(self) -> int:
        """Period of its steps [ticks]."""
        return self._map.period

    @property
    def used(self) -> frozenset[str]:
        """Signals that its inputs take."""
        return frozenset(link.signal for link in self._map.inputs)

    def outputs(self, signals: Mapping[str, float]) -> dict[str, float]:
        """Signals of its outputs now, with these inputs, without a step.

        Raises:
            FmuError: if it fails, stalls, crashes or gives no finite number.
        """
        return self._called(0, signals)

    def step(self, ticks: int, signals: Mapping[str, float]) -> dict[str, float]:
        """Signals of its outputs after a step over ``ticks`` that begins with these inputs.

        Raises:
            FmuError: if it fails, stalls, crashes or gives no finite number.
        """
        found = self._called(ticks, signals)
        self.ticks += ticks
        return found

    def _called(self, ticks: int, signals: Mapping[str, float]) -> dict[str, float]:
        values = self._process.step(self.ticks * TICK, ticks * TICK, self._map.values(signals))
        if not all(map(math.isfinite, values)):
            raise self._not_finite(values)
        return self._map.signals(values)

    def _not_finite(self, values: Sequence[float]) -> FmuError:
        links = zip(self._map.outputs, values, strict=True)
        name, value = next((link.variable.name, value) for link, value in links if not math.isfinite(value))
        return FmuError(f"{self._fmu.path}: at {self.ticks * TICK:g} s its output {name} is {value}")

    def restart(self) -> None:
        """Begin anew."""
        self._process.close()
        self._process, self.ticks = self._started(), 0

    def close(self) -> None:
        """End its process."""
        self._process.close()

    def __deepcopy__(self, memo: dict[int, Any]) -> FmuInstance:
        """Another instance in the same state.

        Raises:
            ValueError: one line, if the FMU's state can't be taken.
        """
        other = copy.copy(self)
        other._process = self._process.copy()
        return other
