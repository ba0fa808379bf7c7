"""Opening of links from the command line, and of the exchange of a run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from scenarios.fmi_import.driver import driver_signals
from scenarios.fmi_import.law import law_signals
from scenarios.fmi_import.mapping import Signal
from scenarios.hil.demands import Demands, driver_demands
from scenarios.hil.exchange import Exchange
from scenarios.hil.link import Link
from scenarios.hil.record import RecordedDemands
from scenarios.hil.udp import UdpLink
from scenarios.options.outside import OutsideOptions


@contextmanager
def opened_links(udp: str | None, can: str | None) -> Iterator[list[Link]]:
    """Open the links of ``--udp`` and ``--can``, and close them at the end.

    Raises:
        ValueError: one line, if one can't be opened.
    """
    with ExitStack() as cleanup:
        links: list[Link] = []
        if udp is not None:
            links.append(UdpLink(udp))
            cleanup.callback(links[-1].close)
        if can is not None:
            from scenarios.hil.can_bus import CanLink

            links.append(CanLink(can))
            cleanup.callback(links[-1].close)
        yield links


def opened_exchange(
    options: OutsideOptions,
    links: Sequence[Link],
    trailers: Sequence[Demands],
    n_units: int,
    *,
    is_paced: bool,
    is_driven: bool,
) -> Exchange | None:
    """The exchange of a run; None if nothing goes out or comes in.

    Args:
        options: of the scenario.
        links: open ones.
        trailers: demands of all watched trailers, front to rear; those without steered axles are empty.
        n_units: number of units.
        is_paced: the run keeps wall time.
        is_driven: the run has a driver.

    Raises:
        ValueError: one line, if demands are asked for that nobody gives or takes.
    """
    parts = _taken(options, trailers, is_driven=is_driven)
    if not parts and not links:
        return None
    record = None if options.record is None or not parts else RecordedDemands(Path(options.record), parts)
    asked = f"outside.demands = {options.demands}"
    if parts and record is None:
        if not links:
            raise ValueError(f"{asked}: needs --udp, --can, or outside.record of an earlier run")
        if not is_paced and not options.wait:
            raise ValueError(f"{asked}: needs --paced, or outside.wait, for else the loop does not wait for demands")
    for link in links:
        link.prepare(signals_of(trailers, n_units), parts if record is None else ())
    return Exchange(options, parts, links, record)


def _taken(options: OutsideOptions, trailers: Sequence[Demands], *, is_driven: bool) -> tuple[Demands, ...]:
    steered = [trailer for trailer in trailers if trailer.numbers]
    if options.demands in ("trailer", "both") and not steered:
        raise ValueError(f"outside.demands = {options.demands}: the vehicle has no trailer with steered axles")
    if options.demands in ("driver", "both") and not is_driven:
        raise ValueError(f"outside.demands = {options.demands}: the motion is prescribed, nobody drives")
    return (
        *(steered if options.demands in ("trailer", "both") else ()),
        *([driver_demands()] if options.demands in ("driver", "both") else ()),
    )


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
