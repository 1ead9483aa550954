"""Formulas f(x, y, z) typed by the user, compiled into a tree of NumPy functions. Only arithmetic is allowed."""

import ast
import operator
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...errors import SettingsError
from ...messages import format_count

MAX_LENGTH = 2000  # characters; longer formulas could nest deeper than Python's stack allows
Value = np.ndarray | float

OPERATORS = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: np.divide, ast.FloorDiv: np.floor_divide,
    ast.Mod: np.mod, ast.Pow: np.float_power, ast.UAdd: operator.pos, ast.USub: operator.neg,
    ast.Lt: np.less, ast.LtE: np.less_equal, ast.Gt: np.greater, ast.GtE: np.greater_equal, ast.Eq: np.equal, ast.NotEq: np.not_equal,
}  # fmt: skip
FUNCTIONS: dict[str, tuple[int, Callable[..., Value]]] = {
    name: (1, getattr(np, name))
    for name in (
        "sin", "cos", "tan", "arcsin", "arccos", "arctan", "sinh", "cosh", "tanh", "exp", "log", "log2", "log10", "sqrt", "abs", "floor",
        "ceil", "rint", "sign",
    )
} | {name: (2, getattr(np, name)) for name in ("arctan2", "hypot", "minimum", "maximum", "fmod")} | {
    "min": (2, np.minimum), "max": (2, np.maximum), "pow": (2, np.float_power), "mod": (2, np.mod), "round": (1, np.rint),
    "where": (3, np.where), "clip": (3, np.clip),
    "xor": (2, lambda a, b: (_to_integers(a) ^ _to_integers(b)).astype(np.float64)),
    "bitand": (2, lambda a, b: (_to_integers(a) & _to_integers(b)).astype(np.float64)),
    "bitor": (2, lambda a, b: (_to_integers(a) | _to_integers(b)).astype(np.float64)),
}  # fmt: skip
VARIABLES = ("x", "y", "z")
CONSTANTS = {"pi": np.pi, "e": np.e, "tau": 2.0 * np.pi}
MAX_INTEGER = 2.0**62


@dataclass(frozen=True)
class Expression:
    """A part of a formula.

    evaluate: computes it from the values of the variables. arrays: maximum number of arrays of the full size that exist at once meanwhile.
    """

    evaluate: Callable[[dict[str, Value]], Value]
    arrays: int = 0


class Formula:
    """A compiled formula. Call it with coordinates whose shapes broadcast."""

    def __init__(self, text: str) -> None:
        """Compile `text`.

        Raises:
            SettingsError: it is empty, has a syntax error, or contains anything but arithmetic.
        """
        self.text = text
        if not text.strip():
            raise SettingsError('The formula is empty; type one, for example "20*sin(x/30)*sin(y/30) - z".', ("formula",))
        if len(text) > MAX_LENGTH:
            raise SettingsError(f"The formula has {len(text)} characters; the maximum is {MAX_LENGTH}.", ("formula",))
        try:
            self._expression = _compile(ast.parse(text.strip().replace("^", "**"), mode="eval").body)
            self(*np.ones((3, 1)))
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise SettingsError(
                f'The formula "{_abbreviate(text)}" has a syntax error; check its parentheses and operators.', ("formula",)
            ) from None

    def __call__(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> Value:
        """Evaluate at coordinates in scene units. Undefined values are NaN or infinite."""
        with np.errstate(all="ignore"):
            return self._expression.evaluate({"x": x, "y": y, "z": z})


def _compile(node: ast.expr) -> Expression:
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        try:
            number = float(node.value)
        except OverflowError:
            raise SettingsError("The formula contains a number that is too large.", ("formula",)) from None
        return Expression(lambda _variables: number)
    if isinstance(node, ast.Name):
        return _compile_name(node.id)
    if isinstance(node, ast.UnaryOp) and type(node.op) in OPERATORS:
        return _compile_call(OPERATORS[type(node.op)], [node.operand])
    if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
        return _compile_call(OPERATORS[type(node.op)], [node.left, node.right])
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in OPERATORS:
        return _compile_call(OPERATORS[type(node.ops[0])], [node.left, node.comparators[0]])
    if isinstance(node, ast.IfExp):
        return _compile_call(np.where, [node.test, node.body, node.orelse])
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in FUNCTIONS and not node.keywords:
        argument_count, function = FUNCTIONS[node.func.id]
        if len(node.args) == argument_count:
            return _compile_call(function, node.args)  # refuses starred arguments
        raise SettingsError(
            f'The function "{node.func.id}" of the formula takes {format_count(argument_count, "argument")}, not {len(node.args)}.',
            ("formula",),
        )
    raise SettingsError(f'"{_abbreviate(ast.unparse(node))}" is not allowed in the formula; allowed are {_allowed_terms()}.', ("formula",))


def _compile_name(name: str) -> Expression:
    if name in CONSTANTS:
        number = CONSTANTS[name]
        return Expression(lambda _variables: number)
    if name in VARIABLES:
        return Expression(lambda variables: variables[name])
    raise SettingsError(f'"{_abbreviate(name)}" is unknown in the formula; allowed are {_allowed_terms()}.', ("formula",))


def _compile_call(function: Callable[..., Value], nodes: list[ast.expr]) -> Expression:
    """Compile a function of operands. The operand that needs the most memory is evaluated first, while no other one is stored.

    This is the order of Sethi and Ullman (1970): N operators need at most about log2(N) arrays.
    """
    operands = [_compile(node) for node in nodes]
    order = sorted(range(len(operands)), key=lambda index: -operands[index].arrays)
    arrays = max(operands[index].arrays + rank for rank, index in enumerate(order))

    def evaluate(variables: dict[str, Value]) -> Value:
        values: list[Value] = [0.0] * len(operands)
        for index in order:
            values[index] = operands[index].evaluate(variables)
        return _booleans_to_numbers(function(*values))

    return Expression(evaluate, max(arrays, 1))


def _booleans_to_numbers(value: Value) -> Value:
    """Return booleans as 0 and 1, other values unchanged."""
    return value * 1.0 if np.asarray(value).dtype.kind == "b" else value


def _to_integers(values: Value) -> np.ndarray:
    """Return numbers rounded down to int64."""
    return np.nan_to_num(np.clip(np.floor(values), -MAX_INTEGER, MAX_INTEGER)).astype(np.int64)


def _allowed_terms() -> str:
    return f"{', '.join(VARIABLES)}, {', '.join(CONSTANTS)}, numbers, + - * / // % ** < > ( ), a if b else c, and {', '.join(FUNCTIONS)}"


def _abbreviate(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."
