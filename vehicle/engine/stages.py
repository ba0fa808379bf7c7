"""Splitting of a tape: operations on some arguments only are computed once, before a loop over the others."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from typing import NamedTuple

from vehicle.engine.tape import Constant, Entry, Node, Operation, Tape, Writer


class Stages(NamedTuple):
    """A tape in two parts: ``late`` takes the arguments of the whole and then the result of ``early``."""

    early: Tape
    late: Tape


def stages(tape: Tape, known: Collection[int], *, forget: bool) -> Stages:
    """Split into the operations on ``known`` arguments (by number) only, and the rest. Arguments keep their numbers.

    With ``forget`` the rest does not read the known arguments either: their entries are carried over.
    """
    early = _early(tape, known)
    wanted = {a for k, node in enumerate(tape.nodes) if not early[k] for a in _operands(node)} | set(tape.result)
    kinds = (Operation, Entry) if forget else (Operation,)
    carried = [k for k in sorted(wanted) if early[k] and isinstance(tape.nodes[k], kinds)]
    entries: dict[int, Node] = {k: Entry(len(tape.sizes), i) for i, k in enumerate(carried)}
    late = {k: entries.get(k, node) for k, node in enumerate(tape.nodes)}
    return Stages(
        early=_only_needed(tape.sizes, dict(enumerate(tape.nodes)), carried),
        late=_only_needed((*tape.sizes, len(carried)), late, tape.result),
    )


def with_reciprocals(tape: Tape, known: Collection[int]) -> Tape:
    """The tape with divisions by what depends on ``known`` arguments only as products with a reciprocal.

    The reciprocal is then an early operation, and the product takes a fraction of a division's time.
    """
    early = _early(tape, known)
    return _multiplied(
        tape, {k for k, node in enumerate(tape.nodes) if _divides(node) and not early[k] and early[_operands(node)[-1]]}
    )


def with_common_reciprocals(tape: Tape) -> Tape:
    """The tape with several divisions by one number as products with one reciprocal, which suits compiled code."""
    divisors = Counter(_operands(node)[-1] for node in tape.nodes if _divides(node))
    return _multiplied(
        tape, {k for k, node in enumerate(tape.nodes) if _divides(node) and divisors[_operands(node)[-1]] > 1}
    )


def _divides(node: Node) -> bool:
    return isinstance(node, Operation) and node.name in ("div", "inv")


def _multiplied(tape: Tape, divisions: Collection[int]) -> Tape:
    """The tape with these divisions as products with a reciprocal."""
    writer, number = Writer(), list[int]()
    one = Constant(1.0)
    for k, node in enumerate(tape.nodes):
        if isinstance(node, Operation):
            operands = tuple(number[a] for a in node.operands)
            node = Operation(node.name, operands)
            if k in divisions:
                node = Operation("inv", operands[-1:])
                if operands[:-1] and operands[0] != writer.number(one):
                    reciprocal = writer.write(node)
                    node = Operation("mul", (min(operands[0], reciprocal), max(operands[0], reciprocal)))
        number.append(writer.write(node))
    return Tape(tape.sizes, writer.nodes, tuple(number[k] for k in tape.result))


def _early(tape: Tape, known: Collection[int]) -> list[bool]:
    """For every node, whether it depends on ``known`` arguments only."""
    early: list[bool] = []
    for node in tape.nodes:
        if isinstance(node, Entry):
            early.append(node.argument in known)
        else:
            early.append(isinstance(node, Constant) or all(early[a] for a in node.operands))
    return early


def _operands(node: Node) -> tuple[int, ...]:
    return node.operands if isinstance(node, Operation) else ()


def _only_needed(sizes: tuple[int, ...], nodes: dict[int, Node], result: Collection[int]) -> Tape:
    """Tape of the nodes on which the result depends."""
    needed = set(result)
    for k in sorted(nodes, reverse=True):
        if k in needed:
            needed.update(_operands(nodes[k]))
    writer = Writer()
    number: dict[int, int] = {}
    for k in sorted(needed):
        node = nodes[k]
        if isinstance(node, Operation):
            node = Operation(node.name, tuple(number[a] for a in node.operands))
        number[k] = writer.write(node)
    return Tape(sizes, writer.nodes, tuple(number[k] for k in result))
