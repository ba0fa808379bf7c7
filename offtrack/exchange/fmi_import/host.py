"""Process that an FMU runs in: its crashes, endless steps and prints stay out of offtrack.

Started by ``instance.py`` as ``python -m offtrack.exchange.fmi_import.host``. It reads requests from standard
input and answers on standard output; whatever the FMU prints or logs goes to standard error. The first request is a
JSON line that describes the FMU; the others begin with one byte, as `offtrack.exchange.fmi_import.host` says.

A request is one byte: ``STEP`` is followed by time, length and inputs as doubles, ``SET_STATE`` by a size and as many
bytes. An answer is one byte, a size and as many bytes: outputs as doubles, a state, or the text of a failure.
"""

import ctypes
import importlib
import json
import os
import struct
import sys
from collections.abc import Callable, Sequence
from typing import Any, BinaryIO, Final, cast

KINDS: Final = ("Real", "Float64")
_STATUS: Final = ("ok", "warning", "discard", "error", "fatal", "pending")
_FAILED: Final = 2  # the least status of a failure


def setter(fmu: Any, version: int, references: Sequence[int]) -> Callable[[bytes], None]:
    """Function that sets floating-point variables from doubles."""
    call, values = _transfer(fmu, "Set", version, references)
    size = ctypes.sizeof(values)

    def set_values(content: bytes) -> None:
        ctypes.memmove(values, content, size)
        call()

    return set_values


def getter(fmu: Any, version: int, references: Sequence[int]) -> Callable[[], bytes]:
    """Function that gets floating-point variables as doubles."""
    call, values = _transfer(fmu, "Get", version, references)
    size = ctypes.sizeof(values)

    def get_values() -> bytes:
        call()
        return ctypes.string_at(values, size)

    return get_values


def stepper(fmu: Any, version: int) -> Callable[[float, float], None]:
    """Function that does a step from a time over a length [s]."""
    instance = ctypes.c_void_p(fmu.component)
    if version == 2:
        function = _function(fmu, "fmi2DoStep", (ctypes.c_double, ctypes.c_double, ctypes.c_int))
        return lambda time, length: _check("fmi2DoStep", function(instance, time, length, 1))
    flags = [ctypes.c_bool() for _ in range(3)]  # event needed, terminate, returned early
    reached = ctypes.c_double()
    pointers = [*map(ctypes.byref, flags), ctypes.byref(reached)]
    kinds = (ctypes.c_double, ctypes.c_double, ctypes.c_bool, *(ctypes.c_void_p,) * 4)
    function = _function(fmu, "fmi3DoStep", kinds)

    def step(time: float, length: float) -> None:
        _check("fmi3DoStep", function(instance, time, length, True, *pointers))
        if flags[1]:
            raise RuntimeError("it asks to end the simulation")

    return step


def _transfer(fmu: Any, way: str, version: int, references: Sequence[int]) -> tuple[Callable[[], None], Any]:
    """Function that moves values between the FMU and an array, and the array."""
    count = len(references)
    instance, places = ctypes.c_void_p(fmu.component), (ctypes.c_uint * count)(*references)
    values = (ctypes.c_double * count)()
    name = f"fmi{version}{way}{'Real' if version == 2 else 'Float64'}"
    kinds = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p, ctypes.c_size_t)
    function = _function(fmu, name, kinds[: 3 if version == 2 else 4])
    arguments = (instance, places, count, values) if version == 2 else (instance, places, count, values, count)
    return lambda: _check(name, function(*arguments)), values


def _function(fmu: Any, name: str, kinds: Sequence[type]) -> Any:
    address = ctypes.cast(getattr(fmu.dll, name), ctypes.c_void_p).value
    return ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, *kinds)(address or 0)


def _check(name: str, status: int) -> None:
    if status >= _FAILED:
        meaning = _STATUS[status] if status < len(_STATUS) else "unknown"
        raise RuntimeError(f"{name} failed with status {status} ({meaning})")


STEP: Final = b"s"
STATE: Final = b"g"
SET_STATE: Final = b"r"
END: Final = b"q"
DONE: Final = b"+"
FAILED: Final = b"-"
SIZE: Final = struct.Struct("=I")
HEAD: Final = 1 + SIZE.size  # of an answer [bytes]


def answer(out: BinaryIO, content: bytes, mark: bytes = DONE) -> None:
    """Answer with content."""
    out.write(mark + SIZE.pack(len(content)) + content)


def refuse(out: BinaryIO, error: Exception) -> None:
    """Answer with a failure."""
    answer(out, f"{type(error).__name__}: {error}".encode(errors="replace"), FAILED)


class Host:
    """An FMU instance and its variables."""

    def __init__(self, start: dict[str, Any]) -> None:
        """Load the library, create the instance and set its start values."""
        self._version = int(start["version"])
        self._fmu = _loaded(self._version, start)
        self._begin(start)
        self._set_inputs = _setter(self._fmu, self._version, start["inputs"])
        self._get_outputs = _getter(self._fmu, self._version, start["outputs"])
        self._do_step = stepper(self._fmu, self._version)

    def _begin(self, start: dict[str, Any]) -> None:
        fmu = self._fmu
        fmu.instantiate(loggingOn=False)
        if self._version == 2:
            fmu.setupExperiment(startTime=0.0)
        for kind, reference, value in start["parameters"]:
            _set(fmu, kind, [reference], [value])
        fmu.enterInitializationMode()  # at time 0
        fmu.exitInitializationMode()

    def step(self, time: float, length: float, inputs: bytes) -> bytes:
        """Outputs at the end of a step from ``time`` over ``length`` [s], which begins with these inputs; doubles."""
        self._set_inputs(inputs)
        if length > 0.0:
            self._do_step(time, length)
        return self._get_outputs()

    def state(self) -> bytes:
        """State of the instance."""
        state = self._of_state("get")()
        content = self._of_state("serialize")(state)
        self._of_state("free")(state)
        return bytes(content)

    def set_state(self, content: bytes) -> None:
        """Go on from a state."""
        state = self._of_state("deSerialize" if self._version == 2 else "deserialize")(content)
        self._of_state("set")(state)
        self._of_state("free")(state)

    def _of_state(self, verb: str) -> Callable[..., Any]:
        """Function of the state, which the versions of FMI spell differently."""
        function: Callable[..., Any] = getattr(self._fmu, verb + ("FMUstate" if self._version == 2 else "FMUState"))
        return function

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
    fmi, fmpy = importlib.import_module(f"fmpy.fmi{version}"), sys.modules["fmpy"]
    if version == 2:
        return fmi.FMU2Slave(**common)
    name = start["identifier"] + fmpy.sharedLibraryExtension
    library = os.path.join(start["folder"], "binaries", fmpy.platform_tuple, name)
    return fmi.FMU3Slave(libraryPath=library, **common)


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
    if kinds.keys() <= set(KINDS):  # all at once: the usual case
        return setter(fmu, version, [reference for _, reference in variables])
    values = struct.Struct(f"={len(variables)}d")

    def set_values(content: bytes) -> None:
        given = values.unpack(content)
        for kind, (indices, references) in kinds.items():
            _set(fmu, kind, references, [given[k] for k in indices])

    return set_values


def _getter(fmu: Any, version: int, variables: Sequence[Sequence[Any]]) -> Callable[[], bytes]:
    """Function that gets variables [kind, reference] as doubles in their order."""
    kinds = _by_kind(variables)
    if kinds.keys() <= set(KINDS):
        return getter(fmu, version, [reference for _, reference in variables])
    values, found = struct.Struct(f"={len(variables)}d"), [0.0] * len(variables)

    def get_values() -> bytes:
        for kind, (indices, references) in kinds.items():
            for k, value in zip(indices, getattr(fmu, f"get{kind}")(references), strict=True):
                found[k] = float(value)
        return values.pack(*found)

    return get_values


def main() -> None:
    """Serve one FMU until the requests end."""
    requests, answers = os.fdopen(os.dup(0), "rb"), cast(BinaryIO, os.fdopen(os.dup(1), "wb", buffering=0))
    os.dup2(2, 1)  # the FMU's prints
    sys.stdout = sys.stderr
    start = json.loads(requests.readline())
    try:
        host = Host(start)
    except Exception as error:
        refuse(answers, error)
        return
    answer(answers, b"")
    _serve(host, requests, answers, len(start["inputs"]))


def _serve(host: Host, requests: BinaryIO, answers: BinaryIO, n_inputs: int) -> None:
    head = struct.Struct("=2d")
    size_of_step = head.size + 8 * n_inputs
    while True:
        request = requests.read(1)
        if request in (b"", END):
            host.end()
            return
        try:
            if request == STEP:
                content = requests.read(size_of_step)
                time, length = head.unpack_from(content)
                answer(answers, host.step(time, length, content[head.size :]))
            elif request == STATE:
                answer(answers, host.state())
            elif request == SET_STATE:
                (size,) = SIZE.unpack(requests.read(SIZE.size))
                host.set_state(requests.read(size))
                answer(answers, b"")
        except Exception as error:
            refuse(answers, error)
            return


if __name__ == "__main__":
    main()
