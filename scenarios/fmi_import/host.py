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
        self._set_inputs = _setter(self._fmu, self._version, start["inputs"])
        self._get_outputs = _getter(self._fmu, self._version, start["outputs"])
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

    def step(self, time: float, length: float, inputs: bytes) -> bytes:
        """Outputs at the end of a step from ``time`` over ``length`` [s], which begins with these inputs; doubles."""
        self._set_inputs(inputs)
        if length > 0.0:
            self._do_step(time, length)
        return self._get_outputs()

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


def _setter(fmu: Any, version: int, variables: Sequence[Sequence[Any]]) -> Callable[[bytes], None]:
    """Function that sets variables [kind, reference] from doubles in their order."""
    kinds = _by_kind(variables)
    if not variables:
        return lambda _: None
    if kinds.keys() <= set(direct.KINDS):  # all at once: the usual case
        return direct.setter(fmu, version, [reference for _, reference in variables])
    values = struct.Struct(f"={len(variables)}d")

    def set_values(content: bytes) -> None:
        given = values.unpack(content)
        for kind, (indices, references) in kinds.items():
            _set(fmu, kind, references, [given[k] for k in indices])

    return set_values


def _getter(fmu: Any, version: int, variables: Sequence[Sequence[Any]]) -> Callable[[], bytes]:
    """Function that gets variables [kind, reference] as doubles in their order."""
    kinds = _by_kind(variables)
    if kinds.keys() <= set(direct.KINDS):
        return direct.getter(fmu, version, [reference for _, reference in variables])
    values, found = struct.Struct(f"={len(variables)}d"), [0.0] * len(variables)

    def get_values() -> bytes:
        for kind, (indices, references) in kinds.items():
            for k, value in zip(indices, getattr(fmu, f"get{kind}")(references), strict=True):
                found[k] = float(value)
        return values.pack(*found)

    return get_values


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
    _serve(host, requests, answers, len(start["inputs"]))


def _serve(host: Host, requests: BinaryIO, answers: Any, n_inputs: int) -> None:
    head = struct.Struct("=2d")
    size_of_step = head.size + 8 * n_inputs
    while True:
        request = requests.read(1)
        if request in (b"", wire.END):
            host.end()
            return
        try:
            if request == wire.STEP:
                content = requests.read(size_of_step)
                time, length = head.unpack_from(content)
                wire.answer(answers, host.step(time, length, content[head.size :]))
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
