"""A bench behind UDP and CAN links: the signals that go out, and the UDP link."""

from __future__ import annotations

import errno
import ipaddress
import json
import select
import socket
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Final, Protocol

from offtrack.exchange.fmi_import.fmu_parts import driver_inputs, driver_signals, law_signals
from offtrack.exchange.fmi_import.mapping import Signal
from offtrack.exchange.fmi_import.numbered_signals import estimate_values, reading_values
from scenarios.loop.bench import Demands, Link, Numbers, Sensed
from sensors.messages import EgoState
from vehicle.foundation.user_file import reason

if TYPE_CHECKING:
    from scenarios.assembly.trailer_run import Assembly

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
def opened_bench(udp: str | None, can: str | None) -> Iterator[LinkedBench | None]:
    """Open the links of ``--udp`` and ``--can``, and close them at the end; None without any.

    Raises:
        ValueError: one line, if one can't be opened.
    """
    with ExitStack() as cleanup:
        links: list[BenchLink] = []
        if udp is not None:
            links.append(UdpLink(udp))
            cleanup.callback(links[-1].close)
        if can is not None:
            from offtrack.exchange.bench.can_bus import CanLink

            links.append(CanLink(can))
            cleanup.callback(links[-1].close)
        yield LinkedBench(links) if links else None


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
