"""Expressions as lists of single operations, from which every back end is generated.

The list is in single-assignment form: node k is computed once, from nodes before it. Equal operations share a node.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple, TypeAlias

import casadi as ca

_UNARY: Final = {
    ca.OP_NEG: "neg",
    ca.OP_INV: "inv",
    ca.OP_SQRT: "sqrt",
    ca.OP_SIN: "sin",
    ca.OP_COS: "cos",
    ca.OP_TAN: "tan",
    ca.OP_ASIN: "asin",
    ca.OP_ACOS: "acos",
    ca.OP_ATAN: "atan",
    ca.OP_SINH: "sinh",
    ca.OP_COSH: "cosh",
    ca.OP_TANH: "tanh",
    ca.OP_EXP: "exp",
    ca.OP_LOG: "log",
    ca.OP_FABS: "abs",
    ca.OP_SIGN: "sign",
    ca.OP_FLOOR: "floor",
    ca.OP_CEIL: "ceil",
    ca.OP_NOT: "not",
}
_BINARY: Final = {
    ca.OP_ADD: "add",
    ca.OP_SUB: "sub",
    ca.OP_MUL: "mul",
    ca.OP_DIV: "div",
    ca.OP_POW: "pow",
    ca.OP_CONSTPOW: "pow",
    ca.OP_ATAN2: "atan2",
    ca.OP_HYPOT: "hypot",
    ca.OP_COPYSIGN: "copysign",
    ca.OP_FMIN: "min",
    ca.OP_FMAX: "max",
    ca.OP_LT: "lt",
    ca.OP_LE: "le",
    ca.OP_EQ: "eq",
    ca.OP_NE: "ne",
    ca.OP_AND: "and",
    ca.OP_OR: "or",
    ca.OP_IF_ELSE_ZERO: "if_else_zero",  # second operand where the first is not 0, else 0
}
_OF_ITSELF: Final = {ca.OP_SQ: "mul", ca.OP_TWICE: "add"}  # the operand twice
_COMMUTATIVE: Final = frozenset(["add", "mul", "min", "max", "hypot", "eq", "ne", "and", "or"])
OPERATIONS: Final = frozenset([*_UNARY.values(), *_BINARY.values()])


class Entry(NamedTuple):
    """Entry of an argument."""

    argument: int
    place: int


class Constant(NamedTuple):
    """Constant number."""

    value: float


class Operation(NamedTuple):
    """Operation on nodes before it."""

    name: str  # one of OPERATIONS; truth values are 0 and 1
    operands: tuple[int, ...]  # numbers of nodes


Node: TypeAlias = Entry | Constant | Operation


class Tape(NamedTuple):
    """Vector function of vectors as a list of operations."""

    sizes: tuple[int, ...]  # of the arguments
    nodes: tuple[Node, ...]
    result: tuple[int, ...]  # node of every entry of the result


class Writer:
    """Builder of a tape that writes equal nodes once."""

    def __init__(self) -> None:
        self._numbers: dict[tuple[str, Node], int] = {}

    def write(self, node: Node) -> int:
        """Add a node if it is new, and return its number."""
        key = (type(node).__name__, node)  # named tuples of different types can be equal
        return self._numbers.setdefault(key, len(self._numbers))

    def number(self, node: Node) -> int | None:
        """Number of a node; None if it is not written."""
        return self._numbers.get((type(node).__name__, node))

    @property
    def nodes(self) -> tuple[Node, ...]:
        """Nodes written so far."""
        return tuple(node for _, node in self._numbers)


def tape_of(function: Any) -> Tape:
    """Tape of a ``casadi.Function`` of SX with one dense result.

    Raises:
        ValueError: if it contains an operation that the back ends do not have, or its result has structural zeros.
    """
    if function.n_out() != 1 or not function.sparsity_out(0).is_dense():
        raise ValueError(f"{function.name()} must have one result without structural zeros")
    writer = Writer()
    held: dict[int, int] = {}  # work space of CasADi's virtual machine -> node
    result = [0] * function.numel_out(0)
    for k in range(function.n_instructions()):
        code, operands, places = (
            function.instruction_id(k),
            function.instruction_input(k),
            function.instruction_output(k),
        )
        if code == ca.OP_OUTPUT:
            result[places[1]] = held[operands[0]]
        elif code == ca.OP_INPUT:
            held[places[0]] = writer.write(Entry(*operands))
        elif code == ca.OP_CONST:
            held[places[0]] = writer.write(Constant(function.instruction_constant(k)))
        elif code == ca.OP_ASSIGN:
            held[places[0]] = held[operands[0]]
        else:
            held[places[0]] = writer.write(_operation(code, [held[place] for place in operands]))
    sizes = tuple(function.numel_in(i) for i in range(function.n_in()))
    return Tape(sizes, writer.nodes, tuple(result))


def _operation(code: int, operands: list[int]) -> Operation:
    if code in _OF_ITSELF:
        return Operation(_OF_ITSELF[code], (operands[0], operands[0]))
    if code in _UNARY:
        return Operation(_UNARY[code], (operands[0],))
    if code in _BINARY:
        name = _BINARY[code]
        return Operation(name, tuple(sorted(operands) if name in _COMMUTATIVE else operands))
    raise ValueError(f"operation {code} of CasADi is not supported by the engine")
