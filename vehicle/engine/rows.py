"""Memory rows for the values of a running tape; a row is reused after its value has been read for the last time."""

from __future__ import annotations

from typing import NamedTuple

from vehicle.engine.tape import Operation, Tape


class Rows(NamedTuple):
    """Memory row of every operation of a tape: in the result if it belongs there, else in the work space."""

    in_result: dict[int, int]  # node -> row of the result
    in_work: dict[int, int]  # node -> row of the work space
    n_work: int  # rows of the work space


def rows(tape: Tape) -> Rows:
    """Assign rows to the values of a tape: an operation overwrites an operand that is not read again."""
    in_result = {k: i for i, k in reversed(list(enumerate(tape.result))) if isinstance(tape.nodes[k], Operation)}
    last_read = {a: k for k, node in enumerate(tape.nodes) if isinstance(node, Operation) for a in node.operands}
    in_work: dict[int, int] = {}
    free: list[int] = []
    n_work = 0
    for k, node in enumerate(tape.nodes):
        if isinstance(node, Operation):
            free.extend(in_work[a] for a in set(node.operands) if a in in_work and last_read[a] == k)
            if k not in in_result:
                if not free:
                    free.append(n_work)
                    n_work += 1
                in_work[k] = free.pop()  # the last one freed is the likeliest in the cache
    return Rows(in_result, in_work, n_work)
