"""Process that an FMU runs in: its crashes, endless steps and prints stay out of offtrack.

Started by `scenarios.fmi_import.process` as ``python -m scenarios.fmi_import.host``. It reads requests from standard
input and answers on standard output; whatever the FMU prints or logs goes to standard error. The first request is a
JSON line that describes the FMU; the others begin with one byte, as `scenarios.fmi_import.wire` says.
"""

from __future__ import annotations

import json
import os
import struct
import sys
from collections.abc import Callable, Sequence
from typing import Any, BinaryIO

from scenarios.fmi_import import direct, wire


class Host:
    """An FMU instance and its variables."""

    def __init__(self, start: dict[str, Any]) -> None:
        """Load the library, create the instance and set its start values."""
        self._version = int(start["version"])
        self._fmu = _loaded(self._version, start)
        self._begin(start)
        self._inputs = _setters(self._fmu, self._version, start["inputs"])
        self._outputs = _getters(self._fmu, self._version, start["outputs"])
        self._n_outputs = len(start["outputs"])
        self._do_step = direct.stepper(self._fmu, self._version)

    def _begin(self, start: dict[str, Any]) -> None:
        fmu = self._fmu
        if self._version == 2:
            fmu.instantiate(loggingOn=False)
            fmu.setupExperiment(startTime=0.0)
        else:
            fmu.instantiate(loggingOn=False)
        for kind, reference, value in start["parameters"]:
            _set(fmu, kind, [reference], [value])
        if self._version == 2:
            fmu.enterInitializationMode()
        else:
            fmu.enterInitializationMode(startTime=0.0)
        fmu.exitInitializationMode()

    def step(self, time: float, length: float, values: Sequence[float]) -> list[float]:
        """Outputs at the end of a step from ``time`` over ``length`` [s], which begins with these inputs."""
        for indices, set_values in self._inputs:
            set_values([values[k] for k in indices])
        if length > 0.0:
            self._do_step(time, length)
        out = [0.0] * self._n_outputs
        for indices, get_values in self._outputs:
            for k, value in zip(indices, get_values(), strict=True):
                out[k] = float(value)
        return out

    def state(self) -> bytes:
        """State of the instance."""
        if self._version == 2:
            state = self._fmu.getFMUstate()
            content = self._fmu.serializeFMUstate(state)
            self._fmu.freeFMUstate(state)
        else:
            state = self._fmu.getFMUState()
            content = self._fmu.serializeFMUState(state)
            self._fmu.freeFMUState(state)
        return bytes(content)

    def set_state(self, content: bytes) -> None:
        """Go on from a state."""
        if self._version == 2:
            state = self._fmu.deSerializeFMUstate(content)
            self._fmu.setFMUstate(state)
            self._fmu.freeFMUstate(state)
        else:
            state = self._fmu.deserializeFMUState(content)
            self._fmu.setFMUState(state)
            self._fmu.freeFMUState(state)

    def end(self) -> None:
        """Terminate and free the instance."""
        self._fmu.terminate()
        self._fmu.freeInstance()


def _loaded(version: int, start: dict[str, Any]) -> Any:
    common = {
        "guid": start["token"],
        "modelIdentifier": start["identifier"],
        "unzipDirectory": start["folder"],
        "instanceName": start["identifier"],
        "requireFunctions": False,
    }
    if version == 2:
        from fmpy.fmi2 import FMU2Slave

        return FMU2Slave(**common)
    from fmpy import platform_tuple, sharedLibraryExtension
    from fmpy.fmi3 import FMU3Slave

    library = os.path.join(start["folder"], "binaries", platform_tuple, start["identifier"] + sharedLibraryExtension)
    return FMU3Slave(libraryPath=library, **common)


def _set(fmu: Any, kind: str, references: list[int], values: list[Any]) -> None:
    whole = kind not in ("Real", "Float64", "Float32", "String")
    getattr(fmu, f"set{kind}")(references, [round(value) for value in values] if whole else values)


def _by_kind(variables: Sequence[Sequence[Any]]) -> dict[str, tuple[list[int], list[int]]]:
    """Indices and value references of variables [kind, reference] by kind."""
    kinds: dict[str, tuple[list[int], list[int]]] = {}
    for k, (kind, reference) in enumerate(variables):
        indices, references = kinds.setdefault(kind, ([], []))
        indices.append(k)
        references.append(reference)
    return kinds


def _setters(
    fmu: Any, version: int, variables: Sequence[Sequence[Any]]
) -> list[tuple[list[int], Callable[[list[float]], object]]]:
    def setter(kind: str, references: list[int]) -> Callable[[list[float]], object]:
        if kind in direct.KINDS:
            return direct.setter(fmu, version, references)
        return lambda values: _set(fmu, kind, references, values)

    return [(indices, setter(kind, references)) for kind, (indices, references) in _by_kind(variables).items()]


def _getters(
    fmu: Any, version: int, variables: Sequence[Sequence[Any]]
) -> list[tuple[list[int], Callable[[], Sequence[float]]]]:
    def getter(kind: str, references: list[int]) -> Callable[[], Sequence[float]]:
        if kind in direct.KINDS:
            return direct.getter(fmu, version, references)
        get = getattr(fmu, f"get{kind}")
        return lambda: list(get(references))

    return [(indices, getter(kind, references)) for kind, (indices, references) in _by_kind(variables).items()]


def main() -> None:
    """Serve one FMU until the requests end."""
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb", buffering=0)
    os.dup2(2, 1)  # the FMU's prints
    sys.stdout = sys.stderr
    start = json.loads(requests.readline())
    try:
        host = Host(start)
    except Exception as error:
        wire.refuse(answers, error)
        return
    wire.answer(answers, b"")
    _serve(host, requests, answers, len(start["inputs"]), len(start["outputs"]))


def _serve(host: Host, requests: BinaryIO, answers: Any, n_inputs: int, n_outputs: int) -> None:
    step, values = struct.Struct(f"={2 + n_inputs}d"), struct.Struct(f"={n_outputs}d")
    while True:
        request = requests.read(1)
        if request in (b"", wire.END):
            host.end()
            return
        try:
            if request == wire.STEP:
                time, length, *inputs = step.unpack(requests.read(step.size))
                wire.answer(answers, values.pack(*host.step(time, length, inputs)))
            elif request == wire.STATE:
                wire.answer(answers, host.state())
            elif request == wire.SET_STATE:
                (size,) = wire.SIZE.unpack(requests.read(wire.SIZE.size))
                host.set_state(requests.read(size))
                wire.answer(answers, b"")
        except Exception as error:
            wire.refuse(answers, error)
            return


if __name__ == "__main__":
    main()
