"""What of a tape depends on some arguments alone: computed once, ahead of a loop in which the others change."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

from vehicle.engine.tape import Constant, Entry, Node, Operation, Tape, Writer


class Stages(NamedTuple):
    """A tape in two: ``late`` takes, behind the arguments of the whole, the result of ``early``."""

    early: Tape
    late: Tape


def stages(tape: Tape, known: Collection[int], *, forget: bool) -> Stages:
    """The operations on the ``known`` arguments (by number) alone, and the rest. Arguments keep their numbers.

    With ``forget`` the rest does not look at the known arguments themselves either: their entries are carried over.
    """
    early = [False] * len(tape.nodes)
    for k, node in enumerate(tape.nodes):
        if isinstance(node, Entry):
            early[k] = node.argument in known
        else:
            early[k] = isinstance(node, Constant) or all(early[a] for a in node.operands)
    wanted = {a for k, node in enumerate(tape.nodes) if not early[k] for a in _operands(node)} | set(tape.result)
    worth = (Operation, Entry) if forget else (Operation,)
    carried = [k for k in sorted(wanted) if early[k] and isinstance(tape.nodes[k], worth)]
    entries: dict[int, Node] = {k: Entry(len(tape.sizes), i) for i, k in enumerate(carried)}
    late = {k: entries.get(k, node) for k, node in enumerate(tape.nodes)}
    return Stages(
        early=_only_needed(tape.sizes, dict(enumerate(tape.nodes)), carried),
        late=_only_needed((*tape.sizes, len(carried)), late, tape.result),
    )


def _operands(node: Node) -> tuple[int, ...]:
    return node.operands if isinstance(node, Operation) else ()


def _only_needed(sizes: tuple[int, ...], nodes: dict[int, Node], result: Collection[int]) -> Tape:
    """The tape of these nodes without those that no entry of the result depends on."""
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
