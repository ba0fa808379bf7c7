"""A bench behind UDP and CAN links: the signals that go out, and both links.

A DBC file lays out the CAN bus: a signal of the file is one of offtrack if it has its name. A message with a demand is
received; any other message with a signal of offtrack is sent at every step of control. Units are those of the file.
"""

import errno
import ipaddress
import json
import logging
import select
import socket
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol

from offtrack.exchange.fmi_import.fmu_file import UNITS, Scale, fits
from offtrack.exchange.fmi_import.fmu_parts import driver_inputs, driver_signals, law_signals
from offtrack.exchange.fmi_import.mapping import Signal
from offtrack.exchange.fmi_import.numbered_signals import estimate_values, reading_values
from scenarios.assembly.trailer_run import Assembly
from scenarios.extras import import_extra
from scenarios.loop.bench import Demands, Link, Numbers, Sensed
from sensors.messages import EgoState
from vehicle.foundation.user_file import FileType, nearest, read_bytes, reason, shown

VERSION: Final = 1  # of the layout; the value of "offtrack" in every datagram
_LARGEST: Final = 8_192  # datagram that is read [bytes]
_MOST: Final = 1_000  # datagrams that are read at a time


class UdpLink:
    """Sends signals to a host's port and takes demands from that host."""

    name = "udp"

    def __init__(self, text: str) -> None:
        """Open a link as ``HOST:PORT`` or ``HOST:PORT,PORT``: the host and its port, and the own port for demands.

        Without an own port the system chooses one, and the bench answers to where the signals come from.

        Raises:
            ValueError: one line, if the text is wrong, or the port is in use.
        """
        self._address, own = _addresses(text)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind((_own_host(self._address), own))
        except OSError as error:
            self._socket.close()
            raise ValueError(f"--udp {text}: port {own} can't be opened: {reason(error)}") from None

    @property
    def port(self) -> int:
        """The own port."""
        return int(self._socket.getsockname()[1])

    def prepare(self, signals: Sequence[Signal], parts: Sequence[Demands]) -> None:
        """Nothing to learn: a datagram names its numbers."""

    def send(self, tick: int, values: Mapping[str, float]) -> None:
        """Send one datagram; what the network refuses is lost, as datagrams may be."""
        content = json.dumps({"offtrack": VERSION, "tick": tick, **values}, separators=(",", ":"))
        try:
            self._socket.sendto(content.encode(), self._address)
        except OSError as error:
            if error.errno == errno.EMSGSIZE:
                raise

    def receive(self, timeout: float) -> list[Numbers | str]:
        """Datagrams of the bench; those of other hosts are ignored."""
        if timeout > 0.0:
            select.select([self._socket], [], [], timeout)
        messages: list[Numbers | str] = []
        for _ in range(_MOST):
            try:
                content, (host, _port) = self._socket.recvfrom(_LARGEST)
            except BlockingIOError:
                break
            except OSError:  # an answer of the network to a datagram sent before
                continue
            if host == self._address[0]:
                messages.append(_numbers(content))
        return messages

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def _numbers(content: bytes) -> Numbers | str:
    try:
        message = json.loads(content)
    except (ValueError, RecursionError):
        return "is no JSON"
    if not isinstance(message, dict):
        return "is no JSON object"
    version = message.pop("offtrack", VERSION)
    return message if version == VERSION else f"has the layout {version!r:.20}, not {VERSION}"


def _addresses(text: str) -> tuple[tuple[str, int], int]:
    """Address of the bench, and the own port (0: any)."""
    there, comma, own = text.partition(",")
    host, colon, port = there.rpartition(":")
    numbers = [port, own] if comma else [port]
    if not (host and colon and all(one.isascii() and one.isdigit() and 0 < int(one) < 65_536 for one in numbers)):
        raise ValueError(f"--udp {text}: expected HOST:PORT or HOST:PORT,PORT, such as 127.0.0.1:5005,5006")
    try:
        found = socket.getaddrinfo(host, int(port), socket.AF_INET, socket.SOCK_DGRAM)
    except (OSError, UnicodeError):
        raise ValueError(f"--udp {text}: there is no host '{host}' with an IPv4 address") from None
    address = str(found[0][4][0])
    if (ip := ipaddress.ip_address(address)).is_multicast or address == "255.255.255.255" or ip.is_unspecified:
        raise ValueError(f"--udp {text}: {address} is no address of a single host")
    return (address, int(port)), int(own) if comma else 0


def _own_host(address: tuple[str, int]) -> str:
    """Own address on the way to the bench; on loopback nothing else can reach it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(address)  # sends nothing
        except OSError as error:
            raise ValueError(f"--udp {address[0]}:{address[1]}: {reason(error)}") from None
        return str(probe.getsockname()[0])


class BenchLink(Link, Protocol):
    """A link that can be prepared for its signals, and closed."""

    def prepare(self, signals: Sequence[Signal], parts: Sequence[Demands]) -> None:
        """Learn which signals there are and which demands are taken.

        Raises:
            ValueError: one line, if the link can't carry the demands.
        """

    def close(self) -> None:
        """Close the link; closing twice does no harm."""


class LinkedBench:
    """Signals of a combination for a bench, by the numbered names that FMUs use too."""

    def __init__(self, links: Sequence[BenchLink]) -> None:
        self.links = tuple(links)
        self._station = 0.0  # of the guided point [m]

    def prepare(self, parts: Assembly, trailers: Sequence[Demands], taken: Sequence[Demands]) -> None:
        """Tell the links which signals there are and which demands are taken."""
        self._course, self._speed = parts.course, parts.scenario.speed
        signals = signals_of(trailers, len(parts.vehicle.units))
        self._names = frozenset(signal.name for signal in signals)
        for link in self.links:
            link.prepare(signals, taken)

    def signals(self, tick: int, ego: EgoState, sensed: Sequence[Sensed]) -> dict[str, float]:
        """Signals [SI] by name; the sensors of the last trailer's law come before a driver's eyes."""
        self._station, values = driver_inputs(self._course, self._speed, self._station, tick, ego)
        for one in sensed:
            ending = "" if one is sensed[-1] else f"_{one.trailer}"
            inputs = {**estimate_values(tick, one.off_tracking, self._names), **reading_values(one.signals)}
            values |= {f"{name}{ending}": value for name, value in inputs.items()}
        return {name: float(value) for name, value in values.items() if name in self._names}


@contextmanager
def opened_bench(udp: str | None, can: str | None) -> Iterator[LinkedBench]:
    """Open the links of ``--udp`` and ``--can``, and close them at the end.

    Raises:
        ValueError: one line, if one can't be opened.
    """
    with ExitStack() as cleanup:
        links: list[BenchLink] = []
        for kind, text in ((UdpLink, udp), (CanLink, can)):
            if text is not None:
                links.append(kind(text))
                cleanup.callback(links[-1].close)
        yield LinkedBench(links)


def signals_of(trailers: Sequence[Demands], n_units: int) -> list[Signal]:
    """Signals that go out: those of a law for every trailer, and those of a driver but for the path ahead.

    The hitch's path has a point every metre; its own points would make datagrams of 9 kB.
    """
    last = _of_law(len(trailers[-1].numbers), n_units)
    ahead = [
        signal._replace(name=f"{signal.name}_{trailer.part}")
        for trailer in trailers[:-1]
        for signal in _of_law(len(trailer.numbers), n_units)
    ]
    known = {signal.name for signal in last}
    driving = [
        signal
        for signal in driver_signals(n_units).inputs
        if signal.name not in known and not signal.name.startswith("ahead_")
    ]
    return [*last, *ahead, *driving]


def _of_law(n_steered: int, n_units: int) -> list[Signal]:
    return [signal for signal in law_signals(n_steered, n_units).inputs if not signal.name.startswith("path_point")]


EXAMPLE: Final = "example"  # stands for the shipped DBC file
_INTERFACES: Final = ("virtual", "socketcan")
_KEYS: Final = ("dbc", "interface", "channel")
DBC_FILE: Final = FileType("a description of a CAN bus", 16_000_000)
_MOST_FRAMES: Final = 1_000  # messages that are read at a time


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
        self._can = import_extra("hil", "--can needs", "can", "cantools")
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
        try:
            return self._can.Bus(channel=channel or "offtrack", interface=interface)
        except (self._can.CanError, OSError, ValueError) as error:
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
                try:
                    _encoded(message, fields, {})
                except Exception as error:  # of the packer, as for a signal that can not be 0
                    raise ValueError(f"{self._file}: message {message.name} can not be sent: {error}") from None
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
        if not signal.scale:
            raise ValueError(f"{self._file}: {signal.name} has the factor 0")
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
        for message, fields in self._sent:
            data, extended = _encoded(message, fields, values), message.is_extended_frame
            frame = self._can.Message(arbitration_id=message.frame_id, data=data, is_extended_id=extended)
            try:
                self._bus.send(frame)
            except self._can.CanError:  # a full queue: the next message is newer
                continue

    def receive(self, timeout: float) -> list[Numbers | str]:
        """Messages with demands; all others are ignored."""
        found: list[Numbers | str] = []
        for k in range(_MOST_FRAMES):
            try:
                frame = self._bus.recv(timeout if k == 0 else 0.0)
            except self._can.CanError:
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


def _encoded(message: Any, fields: Mapping[str, _Field], values: Mapping[str, float]) -> bytes:
    """Content of a message; other signals in it are 0."""
    numbers = {signal.name: 0.0 for signal in message.signals}
    for name, field in fields.items():
        physical = (values.get(name, 0.0) - field.scale.offset) / field.scale.factor
        numbers[name] = min(max(physical, field.low), field.high)
    return bytes(message.encode(numbers, scaling=True, strict=False))


def _messages_of(file: str) -> list[Any]:
    """Messages of a DBC file.

    Raises:
        ValueError: one line, if it can't be read.
    """
    path = Path(str(files("offtrack.exchange.bench") / "example.dbc")) if file == EXAMPLE else Path(file)
    content = read_bytes(path, DBC_FILE).decode("cp1252", errors="replace")  # the encoding of DBC files
    logging.getLogger("cantools").setLevel(logging.ERROR)  # it warns of what is refused below
    try:
        database = import_extra("hil", "--can needs", "cantools").database.load_string(content, "dbc")
    except Exception as error:  # of the parser, of any kind
        raise ValueError(f"{file} is no DBC file: {shown(' '.join(str(error).split()))}") from None
    by_id: dict[tuple[int, bool], Any] = {}
    for one in database.messages:
        if (other := by_id.setdefault((one.frame_id, one.is_extended_frame), one)) is not one:
            raise ValueError(f"{file}: the messages {other.name} and {one.name} have the same id")
    return list(by_id.values())
