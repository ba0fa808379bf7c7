"""One tick of the chain as calls of functions: ``integrator.semi_implicit_step``, whose rates are one function.

Brakes are controlled once a tick, by a function of their own.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from vehicle.clock import TICK
from vehicle.combination.chain import brake_control, derivative, relaxation, wheel_travel
from vehicle.combination.description import Vehicle
from vehicle.combination.layout import Input, State, parts, state_sizes
from vehicle.combination.plant_inputs import slices
from vehicle.engine.composite import Call, Composite
from vehicle.integrator import after, damped_rate, half_weight, halfway


def sampled_states(vehicle: Vehicle) -> range:
    """Numbers of the states of brakes, which are controlled once a tick; they are the last ones."""
    at = State(*slices(state_sizes(vehicle)))
    return range(at.brake_pressure.start, at.brake_valve.stop)


def step_in_calls(vehicle: Vehicle, x: ca.SX, v: ca.SX, u: Input[ca.SX], numbers: ca.SX) -> Composite:
    """Function (state, plant's input, numbers) -> state one tick later.

    ``x``, ``v`` and ``numbers`` are its symbols, ``u`` is the chain's input in terms of ``v``.
    """
    s, at, sampled = (
        State(*parts(x, state_sizes(vehicle))),
        State(*slices(state_sizes(vehicle))),
        sampled_states(vehicle),
    )
    n = sampled.start
    travel = wheel_travel(vehicle, s, u) if sampled else ca.SX(0, 1)
    rates = _Rates(ca.vertcat(*derivative(vehicle, s, u))[:n], ca.vertcat(*relaxation(vehicle, s, u))[:n], travel)
    of_rates = ca.Function("rates", [x, v, numbers], [rates.entries])
    calls = [Call(of_rates), Call(_halfway(rates, of_rates), results=(1,)), Call(of_rates, state=2, needed=n)]
    if sampled:
        now = ca.SX.sym("now", rates.entries.numel())
        spin = ca.vertsplit(rates.rate(now)[at.omega])
        brakes = brake_control(vehicle, s, ca.vertsplit(rates.travel(now)), spin)
        later = x[n:] + TICK * ca.vertcat(*brakes.pressure, *brakes.valve)
        calls.append(Call(ca.Function("brakes", [x, v, numbers, now], [ca.cse(later)]), results=(1,)))
    calls.append(Call(_after(rates, of_rates, len(sampled)), results=tuple(range(1, len(calls) + 1))))
    return Composite("step", tuple(calls))


# CasADi's machine runs every operation of these two functions on a whole vector.


def _halfway(rates: _Rates, of_rates: Any) -> Any:
    """Function (state, input, numbers, rates) -> state halfway, and the weights of half a step."""
    x, v, numbers = _arguments(of_rates)
    now = ca.MX.sym("now", of_rates.numel_out(0))
    half = _chosen(half_weight(rates.relaxing(now), TICK), rates.places, half_weight(0.0, TICK))
    continuous = halfway(x[: rates.n], rates.rate(now), half)
    return ca.Function("halfway", [x, v, numbers, now], [ca.vertcat(continuous, x[rates.n :], half)])


def _after(rates: _Rates, of_rates: Any, n_sampled: int) -> Any:
    """Function (state, input, numbers, rates, halfway, rates halfway, brakes later if any) -> state later."""
    x, v, numbers = _arguments(of_rates)
    now, then = ca.MX.sym("now", of_rates.numel_out(0)), ca.MX.sym("then", rates.n)
    between = ca.MX.sym("halfway", x.numel() + rates.n)
    brakes = [ca.MX.sym("brakes", n_sampled)] if n_sampled else []
    damped = _chosen(damped_rate(rates.relaxing(now)), rates.places, 0.0)
    continuous = after(x[: rates.n], rates.rate(now), then, damped, between[x.numel() :])
    return ca.Function("after", [x, v, numbers, now, between, then, *brakes], [ca.vertcat(continuous, *brakes)])


def _arguments(function: Any) -> list[Any]:
    return [ca.MX.sym("v", function.numel_in(k)) for k in range(3)]


class _Rates:
    """The result of the rates' function: rates of the n continuous states, then what relaxes, each expression once."""

    def __init__(self, rate: ca.SX, relaxation: ca.SX, travel: ca.SX) -> None:
        self.n = rate.numel()
        whole = ca.vertsplit(ca.cse(ca.densify(ca.vertcat(rate, relaxation, travel))))
        distinct: dict[Any, int] = {}
        numbers = [
            None if entry.is_zero() else distinct.setdefault(entry.element_hash(), len(distinct))
            for entry in whole[self.n :]
        ]
        self.places, self._travel = numbers[: self.n], numbers[self.n :]  # where they are among the distinct ones
        self._n_relaxing = 1 + max((place for place in self.places if place is not None), default=-1)
        first = [self.n + numbers.index(k) for k in range(len(distinct))]
        self.entries = ca.vertcat(*whole[: self.n], *(whole[k] for k in first))

    def rate(self, entries: Any) -> Any:
        """Rate of every continuous state."""
        return entries[: self.n]

    def relaxing(self, entries: Any) -> Any:
        """The distinct relaxation rates that are not zero; ``places`` tells whose they are."""
        return entries[self.n : self.n + self._n_relaxing]

    def travel(self, entries: Any) -> Any:
        """``wheel_travel``."""
        return _chosen(entries[self.n :], self._travel, 0.0)


def _chosen(entries: Any, places: list[int | None], otherwise: float) -> Any:
    """Entries by place, and a number where there is none."""
    n = entries.numel()
    return ca.vertcat(entries, otherwise)[[n if place is None else place for place in places]]
