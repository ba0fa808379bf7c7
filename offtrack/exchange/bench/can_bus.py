"""Signals and demands on a CAN bus, laid out by a DBC file.

A signal of the file is one of offtrack if it has its name. A message with a demand is received; any other message with
a signal of offtrack is sent at every step of control. Units are those of the file.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, NamedTuple

from offtrack.exchange.fmi_import.fmu_file import UNITS, Scale, fits
from offtrack.exchange.fmi_import.mapping import Signal
from scenarios.loop.bench import Demands, Numbers
from vehicle.foundation.user_file import FileType, nearest, read_bytes, shown

EXAMPLE: Final = "example"  # stands for the shipped DBC file
_INTERFACES: Final = ("virtual", "socketcan")
_KEYS: Final = ("dbc", "interface", "channel")
DBC_FILE: Final = FileType("a description of a CAN bus", 16_000_000)
_MOST: Final = 1_000  # messages that are read at a time


class _Field(NamedTuple):
    """A signal of a DBC file: limits of its values, and their unit."""

    low: float
    high: float
    scale: Scale


class CanLink:
    """A CAN bus that carries signals and demands."""

    name = "can"

    def __init__(self, text: str) -> None:
        """Open a bus as ``dbc=FILE[,interface=virtual|socketcan][,channel=NAME]``.

        The interface virtual connects buses of one process. The file ``example`` is the shipped one.

        Raises:
            ValueError: one line, if the text or the file is wrong, packages are missing, or there is no such bus.
        """
        self._text = f"--can {shown(text)}"
        given = self._keys(text)
        if missing := [name for name in ("can", "cantools") if importlib.util.find_spec(name) is None]:
            raise ValueError(f"--can needs the package {missing[0]}: pip install 'offtrack[hil]'")
        self._file, self._messages = given["dbc"], _messages_of(given["dbc"])
        self._sent: list[tuple[Any, dict[str, _Field]]] = []
        self._received: dict[int, tuple[Any, dict[str, _Field]]] = {}
        self._bus = self._opened(given.get("interface", "virtual"), given.get("channel"))

    def _keys(self, text: str) -> dict[str, str]:
        pairs = [part.partition("=") for part in text.split(",")]
        for key, equals, value in pairs:
            if not (equals and value) or key not in _KEYS:
                raise ValueError(f"{self._text}: expected dbc=FILE[,interface=virtual|socketcan][,channel=NAME]")
        given = {key: value for key, _, value in pairs}
        if "dbc" not in given:
            raise ValueError(f"{self._text}: dbc=FILE is missing; dbc={EXAMPLE} is a shipped one")
        interface = given.get("interface", "virtual")
        if interface not in _INTERFACES:
            raise ValueError(f"{self._text}: interface '{interface}'{nearest(interface, _INTERFACES)}")
        if interface == "socketcan" and "channel" not in given:
            raise ValueError(f"{self._text}: socketcan needs channel=NAME, such as can0")
        return given

    def _opened(self, interface: str, channel: str | None) -> Any:
        import can

        try:
            return can.Bus(channel=channel or "offtrack", interface=interface)
        except (can.CanError, OSError, ValueError) as error:
            raise ValueError(f"{self._text}: the bus can't be opened: {shown(str(error))}") from None

    def prepare(self, signals: Sequence[Signal], parts: Sequence[Demands]) -> None:
        """Find the messages to send and to receive.

        Raises:
            ValueError: one line, if the file lacks a demand or has one in two messages, or a unit does not fit.
        """
        taken = {demand.name: demand.unit for part in parts for demand in part.numbers}
        units = {signal.name: signal.unit for signal in signals}
        places: dict[str, str] = {}
        for message in self._messages:
            demands = [signal.name for signal in message.signals if signal.name in taken]
            for name in demands:
                if name in places:
                    raise ValueError(f"{self._file}: {name} is in two messages, {places[name]} and {message.name}")
                places[name] = message.name
            if demands:
                self._received[message.frame_id] = message, self._fields(message, taken)
            elif fields := self._fields(message, units):
                self._sent.append((message, fields))
        for part in parts:
            for demand in part.numbers:
                if demand.name not in places and demand.default is None:
                    raise ValueError(f"{self._file}: no message has the signal {demand.name}, a demand of {part.part}")

    def _fields(self, message: Any, units: Mapping[str, str]) -> dict[str, _Field]:
        """Signals of a message that are known, by name."""
        known = [signal for signal in message.signals if signal.name in units]
        if known and message.is_multiplexed():
            raise ValueError(f"{self._file}: message {message.name} is multiplexed, which is not supported")
        return {signal.name: self._field(signal, units[signal.name]) for signal in known}

    def _field(self, signal: Any, si: str) -> _Field:
        unit = (signal.unit or "").strip()
        scale = UNITS.get(unit)
        if scale is None or not fits(scale, si):
            raise ValueError(f"{self._file}: {signal.name} has the unit '{shown(unit, 20)}', which is no unit of {si}")
        ends = [float(end) for end in (signal.minimum, signal.maximum) if end is not None]
        low, high = (min(ends), max(ends)) if len(ends) == 2 and ends[0] < ends[1] else (-1e300, 1e300)
        if not signal.is_float:
            first = -(1 << (signal.length - 1)) if signal.is_signed else 0
            raw = first, first + (1 << signal.length) - 1
            physical = sorted(float(signal.scale * value + signal.offset) for value in raw)
            low, high = max(low, physical[0]), min(high, physical[1])
        return _Field(low, high, scale)

    def send(self, tick: int, values: Mapping[str, float]) -> None:
        """Send all messages; a value beyond its signal's limits is sent as the limit."""
        import can

        for message, fields in self._sent:
            numbers = {signal.name: 0.0 for signal in message.signals}
            for name, field in fields.items():
                physical = (values.get(name, 0.0) - field.scale.offset) / field.scale.factor
                numbers[name] = min(max(physical, field.low), field.high)
            data = message.encode(numbers, scaling=True, strict=False)
            try:
                self._bus.send(
                    can.Message(arbitration_id=message.frame_id, data=data, is_extended_id=message.is_extended_frame)
                )
            except can.CanError:  # a full queue: the next message is newer
                continue

    def receive(self, timeout: float) -> list[Numbers | str]:
        """Messages with demands; all others are ignored."""
        import can

        found: list[Numbers | str] = []
        for k in range(_MOST):
            try:
                frame = self._bus.recv(timeout if k == 0 else 0.0)
            except can.CanError:
                break
            if frame is None:
                break
            if frame.is_error_frame or frame.is_remote_frame or frame.arbitration_id not in self._received:
                continue
            found.append(self._numbers(frame))
        return found

    def _numbers(self, frame: Any) -> Numbers | str:
        message, fields = self._received[frame.arbitration_id]
        try:
            numbers = message.decode(bytes(frame.data), decode_choices=False, scaling=True)
        except Exception as error:  # cantools raises errors of its own and of its packer
            return f"is no {message.name}: {shown(str(error), 80)}"
        return {name: field.scale.factor * float(numbers[name]) + field.scale.offset for name, field in fields.items()}

    def close(self) -> None:
        """Leave the bus."""
        self._bus.shutdown()


def _messages_of(file: str) -> list[Any]:
    """Messages of a DBC file.

    Raises:
        ValueError: one line, if it can't be read.
    """
    import cantools

    path = Path(str(files("offtrack.exchange.bench") / "example.dbc")) if file == EXAMPLE else Path(file)
    content = read_bytes(path, DBC_FILE).decode("cp1252", errors="replace")  # the encoding of DBC files
    try:
        database: Any = cantools.database.load_string(content, "dbc")
    except Exception as error:  # of the parser, of any kind
        raise ValueError(f"{file} is no DBC file: {shown(' '.join(str(error).split()))}") from None
    return list(database.messages)
