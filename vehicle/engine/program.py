"""Programs: functions as lists of single operations, split by how often each argument changes.

The list is in single-assignment form: node k is computed once, from nodes before it. Equal operations share a node.
"""

from collections import Counter
from collections.abc import Callable, Collection
from itertools import accumulate, pairwise
from typing import Any, Final, NamedTuple, TypeAlias

import casadi as ca
import numpy as np

from vehicle.engine.function_cache import AnyFunction, composite
from vehicle.frames import FloatArray


class Kind(NamedTuple):
    """Kind of operation."""

    code: int  # of CasADi
    into: Callable[..., Any]  # numpy's function of the operands and the array that takes the result


def _minimum(a: Any, b: Any, out: FloatArray) -> None:
    np.minimum(a, b, out=out)  # these two functions need it by name


def _maximum(a: Any, b: Any, out: FloatArray) -> None:
    np.maximum(a, b, out=out)


def _if_else_zero(condition: Any, value: Any, out: FloatArray) -> None:
    out[...] = np.where(condition != 0.0, value, 0.0)


OPERATIONS: Final = {
    "neg": Kind(ca.OP_NEG, np.negative),
    "inv": Kind(ca.OP_INV, np.reciprocal),
    "sqrt": Kind(ca.OP_SQRT, np.sqrt),
    "sin": Kind(ca.OP_SIN, np.sin),
    "cos": Kind(ca.OP_COS, np.cos),
    "tan": Kind(ca.OP_TAN, np.tan),
    "asin": Kind(ca.OP_ASIN, np.arcsin),
    "acos": Kind(ca.OP_ACOS, np.arccos),
    "atan": Kind(ca.OP_ATAN, np.arctan),
    "sinh": Kind(ca.OP_SINH, np.sinh),
    "cosh": Kind(ca.OP_COSH, np.cosh),
    "tanh": Kind(ca.OP_TANH, np.tanh),
    "exp": Kind(ca.OP_EXP, np.exp),
    "log": Kind(ca.OP_LOG, np.log),
    "abs": Kind(ca.OP_FABS, np.absolute),
    "sign": Kind(ca.OP_SIGN, np.sign),
    "floor": Kind(ca.OP_FLOOR, np.floor),
    "ceil": Kind(ca.OP_CEIL, np.ceil),
    "not": Kind(ca.OP_NOT, np.logical_not),
    "add": Kind(ca.OP_ADD, np.add),
    "sub": Kind(ca.OP_SUB, np.subtract),
    "mul": Kind(ca.OP_MUL, np.multiply),
    "div": Kind(ca.OP_DIV, np.divide),
    "pow": Kind(ca.OP_POW, np.power),
    "atan2": Kind(ca.OP_ATAN2, np.arctan2),
    "hypot": Kind(ca.OP_HYPOT, np.hypot),
    "copysign": Kind(ca.OP_COPYSIGN, np.copysign),
    "min": Kind(ca.OP_FMIN, _minimum),
    "max": Kind(ca.OP_FMAX, _maximum),
    "lt": Kind(ca.OP_LT, np.less),
    "le": Kind(ca.OP_LE, np.less_equal),
    "eq": Kind(ca.OP_EQ, np.equal),
    "ne": Kind(ca.OP_NE, np.not_equal),
    "and": Kind(ca.OP_AND, np.logical_and),
    "or": Kind(ca.OP_OR, np.logical_or),
    "if_else_zero": Kind(ca.OP_IF_ELSE_ZERO, _if_else_zero),  # second operand where the first is not 0, else 0
}
_NAMES: Final = {kind.code: name for name, kind in OPERATIONS.items()} | {ca.OP_CONSTPOW: "pow"}
_OF_ITSELF: Final = {ca.OP_SQ: "mul", ca.OP_TWICE: "add"}  # the operand twice
_COMMUTATIVE: Final = frozenset(["add", "mul", "min", "max", "hypot", "eq", "ne", "and", "or"])


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


class TapeWriter:
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
    writer = TapeWriter()
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
    name = _NAMES.get(code)
    if name is None:
        raise ValueError(f"operation {code} of CasADi is not supported by the engine")
    return Operation(name, tuple(sorted(operands) if name in _COMMUTATIVE else operands))


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
    writer, number = TapeWriter(), list[int]()
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
    writer = TapeWriter()
    number: dict[int, int] = {}
    for k in sorted(needed):
        node = nodes[k]
        if isinstance(node, Operation):
            node = Operation(node.name, tuple(number[a] for a in node.operands))
        number[k] = writer.write(node)
    return Tape(sizes, writer.nodes, tuple(number[k] for k in result))


_STATE, _INPUT, _PARAMETERS = range(3)


class ProgramPart(NamedTuple):
    """Three tapes of one function; each takes its arguments and then the results of the tapes before it."""

    numbers: Tape  # evaluated once per vehicle
    held: Tape  # once per input
    body: Tape  # at every call


class PartCall(NamedTuple):
    """Call of a part, as ``composite.Call``."""

    part: int
    state: int
    results: tuple[int, ...]


class TapeProgram(NamedTuple):
    """Functions, and the calls of them that make up one tick."""

    parts: tuple[ProgramPart, ...]
    calls: tuple[PartCall, ...]

    @property
    def n_state(self) -> int:
        """Length of the state."""
        return self.parts[self.calls[0].part].body.sizes[_STATE]

    @property
    def n_input(self) -> int:
        """Length of the input."""
        return self.parts[0].body.sizes[_INPUT]

    @property
    def n_result(self) -> int:
        """Length of the result."""
        return len(self.parts[self.calls[-1].part].body.result)

    @property
    def numbers_of(self) -> list[slice]:
        """Place of every part's numbers among the values that the program derives from a vehicle's numbers."""
        ends = list(accumulate((len(part.numbers.result) for part in self.parts), initial=0))
        return [slice(start, stop) for start, stop in pairwise(ends)]

    @property
    def n_numbers(self) -> int:
        """Number of values that the program derives from a vehicle's numbers."""
        return sum(len(part.numbers.result) for part in self.parts)


def program_of(function: AnyFunction) -> TapeProgram:
    """Program of a function (state, input, parameters) -> result, or of a composite of several."""
    calls = composite(function).calls
    functions = list(dict.fromkeys(call.function for call in calls))
    numbered = {of: k for k, of in enumerate(functions)}
    return TapeProgram(
        tuple(_part(of) for of in functions),
        tuple(PartCall(numbered[call.function], call.state, call.results) for call in calls),
    )


def _part(function: Any) -> ProgramPart:
    of_scalars = function.expand() if function.is_a("MXFunction") else function
    tape = with_reciprocals(tape_of(of_scalars), {_INPUT, _PARAMETERS})
    numbers, later = stages(tape, {_PARAMETERS}, forget=True)
    held, body = stages(later, {_INPUT, len(tape.sizes)}, forget=False)
    return ProgramPart(numbers, held, body)
