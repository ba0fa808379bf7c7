"""All mutants of a source text: small changes of its meaning, each of one place.

Left out are docstrings, annotations, decorators, texts, messages of exceptions, assertions, ``__repr__`` and what only
type checkers read.
"""

import ast
import copy
from collections.abc import Iterator
from dataclasses import dataclass

_BOUNDARY = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
_NEGATION = {ast.Eq: ast.NotEq, ast.Lt: ast.GtE, ast.Gt: ast.LtE, ast.LtE: ast.Gt, ast.GtE: ast.Lt, ast.In: ast.NotIn}
_NEGATION |= {other: one for one, other in ((ast.Is, ast.IsNot), (ast.Eq, ast.NotEq), (ast.In, ast.NotIn))}
_NEGATION |= {ast.Is: ast.IsNot}
_ARITHMETIC = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult}
_ARITHMETIC |= {ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd}
_PAIRS = "min max,minimum maximum,argmin argmax,sin cos,any all,ceil floor,zeros ones,amin amax,nanmin nanmax"
_CALLS = {a: b for pair in _PAIRS.split(",") for a, b in (pair.split(), pair.split()[::-1])}
_ONLY_CHECKS = {"strict", "slots", "frozen", "kw_only", "copy", "dtype", "encoding"}  # keywords: no change of meaning
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


@dataclass(frozen=True)
class Mutant:
    """A text in the place of another."""

    module: str
    line: int
    function: str  # qualified; of a constant at module level ""
    users: frozenset[str]  # functions of the module whose tests may notice it
    operator: str
    before: str
    after: str
    span: tuple[int, int]  # in the module's bytes

    def __str__(self) -> str:
        return (
            f"{self.module}:{self.line} {self.function or 'constant'}: {' '.join(self.before.split())} -> {self.after}"
        )

    def applied(self, text: str) -> str:
        data = text.encode()
        return (data[: self.span[0]] + self.after.encode() + data[self.span[1] :]).decode()

    def is_python(self, text: str) -> bool:
        try:
            ast.parse(self.applied(text))
        except SyntaxError:
            return False
        return True


def mutants(module: str, text: str) -> list[Mutant]:
    """All mutants of a module, in the order of their places; Python cannot parse some of them."""
    data = text.encode()
    starts = [0]
    for line in data.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    tree = ast.parse(text)
    names = _names_in_functions(tree)
    found = []
    for function, scope, node, operator, after in _changes(tree, "", False):
        span = (starts[node.lineno - 1] + node.col_offset, starts[_end(node) - 1] + (node.end_col_offset or 0))
        users = {function} if function else {name for name, used in names.items() if scope in used}
        before = data[slice(*span)].decode()
        found.append(Mutant(module, node.lineno, function, frozenset(users or names), operator, before, after, span))
    return found


def _end(node: ast.expr | ast.stmt) -> int:
    return node.end_lineno or node.lineno


def _names_in_functions(tree: ast.Module) -> dict[str, set[str]]:
    """Names and attributes that each function of a module mentions."""
    found = {}
    for prefix, body in [("", tree.body), *((f"{c.name}.", c.body) for c in tree.body if isinstance(c, ast.ClassDef))]:
        for f in (f for f in body if isinstance(f, _FUNCTIONS)):
            nodes = list(ast.walk(f))
            found[prefix + f.name] = {n.id for n in nodes if isinstance(n, ast.Name)} | {
                n.attr for n in nodes if isinstance(n, ast.Attribute)
            }
    return found


_Change = tuple[str, str, ast.expr | ast.stmt, str, str]  # function, assigned name, node, operator, new text


def _changes(node: ast.AST, scope: str, within: bool, assigned: str = "") -> Iterator[_Change]:
    """Changes of a node and of all in it; ``within`` a function or method, ``scope`` is the name of the outermost."""
    if isinstance(node, (ast.Expr, ast.Assign, ast.AnnAssign)) and not within:
        target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
        assigned = target.id if isinstance(target, ast.Name) else ""
    if isinstance(node, (ast.expr, ast.stmt)):
        for operator, after in _of(node, within):
            yield scope if within else "", assigned, node, operator, after
    if isinstance(node, (ast.ClassDef, *_FUNCTIONS)):
        if node.name in ("__repr__", "__str__"):
            return
        if not within:
            scope = f"{scope}.{node.name}" if scope else node.name
    for child in _children(node):
        yield from _changes(child, scope, within or isinstance(node, _FUNCTIONS), assigned)


def _children(node: ast.AST) -> Iterator[ast.AST]:
    if isinstance(node, (ast.Raise, ast.Assert, ast.JoinedStr)):
        return
    if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING"):
        return
    for field, value in ast.iter_fields(node):
        if field in ("annotation", "returns", "decorator_list", "bases", "type_params"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.keyword) and child.arg in _ONLY_CHECKS:
                continue
            if isinstance(child, ast.AST):
                yield child


def _of(node: ast.expr | ast.stmt, within: bool) -> Iterator[tuple[str, str]]:
    """Operators that apply to a node, and the text they make of it."""
    match node:
        case ast.Compare():
            for k, op in enumerate(node.ops):
                for name, table in (("comparison boundary", _BOUNDARY), ("comparison negated", _NEGATION)):
                    if type(op) in table:
                        other = copy.copy(node)
                        other.ops = [*node.ops[:k], table[type(op)](), *node.ops[k + 1 :]]
                        yield name, f"({ast.unparse(other)})"
        case ast.BinOp() if type(node.op) in _ARITHMETIC and (within or not isinstance(node.op, ast.BitOr)):
            yield "arithmetic", f"({ast.unparse(ast.BinOp(node.left, _ARITHMETIC[type(node.op)](), node.right))})"
            yield "first operand", f"({ast.unparse(node.left)})"
        case ast.BoolOp():
            swapped = ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)
            yield "and/or", f"({ast.unparse(swapped)})"
            yield "first operand", f"({ast.unparse(node.values[0])})"
        case ast.UnaryOp(op=ast.Not() | ast.USub() | ast.Invert()):
            yield "operator removed", f"({ast.unparse(node.operand)})"
        case ast.Constant(value=bool()):
            yield "boolean", str(not node.value)
        case ast.Constant(value=int() as number):
            yield "integer", f"({number + 1})"
            yield "integer", f"({number - 1})"
        case ast.Constant(value=float() as number):
            yield "number", f"({1.5 * number or 1.0!r})"
            yield "number", f"({-number or -1.0!r})"
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)) if name in _CALLS:
            yield "function", ast.unparse(node.func).removesuffix(name) + _CALLS[name] + _arguments(node)
        case ast.IfExp():
            yield "condition", ast.unparse(ast.IfExp(node.test, node.orelse, node.body))
        case ast.Return(value=ast.expr() as value) if not (isinstance(value, ast.Constant) and value.value is None):
            yield "return None", "return None"
        case ast.Assign(targets=[ast.Tuple(elts=[_, _, *_])], value=ast.Tuple(elts=[one, two, *rest])):
            if ast.unparse(one) != ast.unparse(two):
                exchanged = ast.Tuple([two, one, *rest], ast.Load())
                yield "values exchanged", f"{ast.unparse(node.targets[0])} = {ast.unparse(exchanged)}"
        case ast.Assign(targets=[ast.Attribute() | ast.Subscript()]) | ast.Continue() | ast.Break() | ast.Raise():
            yield "statement dropped", "pass"
        case ast.AugAssign():
            yield "statement dropped", "pass"
            if type(node.op) in _ARITHMETIC:
                swapped_op = ast.AugAssign(node.target, _ARITHMETIC[type(node.op)](), node.value)
                yield "arithmetic", ast.unparse(swapped_op)
        case ast.Expr(value=ast.Call(func=called)) if not ast.unparse(called).startswith(("_log", "log", "warnings.")):
            yield "statement dropped", "pass"


def _arguments(call: ast.Call) -> str:
    return ast.unparse(ast.Call(ast.Name("f", ast.Load()), call.args, call.keywords))[1:]
