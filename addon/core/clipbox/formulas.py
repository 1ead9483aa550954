"""Formulas f(x, y, z) that users type, read into a tree of NumPy functions. Nothing but arithmetic can be written in them."""

import ast
import operator
from collections.abc import Callable

import numpy as np

from ..errors import SettingsError

LONGEST = 2000  # characters; nobody types more, and deep trees end Python's stack
Value = np.ndarray | float
Function = Callable[[dict[str, Value]], Value]

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
    "xor": (2, lambda a, b: (_whole(a) ^ _whole(b)).astype(np.float64)),
    "bitand": (2, lambda a, b: (_whole(a) & _whole(b)).astype(np.float64)),
    "bitor": (2, lambda a, b: (_whole(a) | _whole(b)).astype(np.float64)),
}  # fmt: skip
NAMES = ("x", "y", "z")
CONSTANTS = {"pi": np.pi, "e": np.e, "tau": 2.0 * np.pi}
MOST_OF_WHOLE = 2.0**62


class Formula:
    """A formula that was read, called with coordinates that broadcast."""

    def __init__(self, text: str) -> None:
        """Read `text`.

        Raises:
            SettingsError: when it is empty, cannot be read, or asks for anything but mathematics.
        """
        self.text = text
        if not text.strip():
            raise SettingsError('The formula is empty; type one, for instance "20*sin(x/30)*sin(y/30) - z".')
        if len(text) > LONGEST:
            raise SettingsError(f"The formula has {len(text)} characters; the most is {LONGEST}.")
        try:
            self._function = _read(ast.parse(text.strip().replace("^", "**"), mode="eval").body)
            self(*np.ones((3, 1)))
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise SettingsError(f'The formula "{_short(text)}" cannot be read; check its brackets and operators.') from None

    def __call__(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> Value:
        """Values at coordinates in scene units; what has none is not a number, or infinite."""
        with np.errstate(all="ignore"):
            return self._function({"x": x, "y": y, "z": z})


def _read(node: ast.expr) -> Function:
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        try:
            number = float(node.value)
        except OverflowError:
            raise SettingsError("The formula holds a number that is too large.") from None
        return lambda _given: number
    if isinstance(node, ast.Name):
        return _named(node.id)
    if isinstance(node, ast.UnaryOp) and type(node.op) in OPERATORS:
        return _applied(OPERATORS[type(node.op)], [node.operand])
    if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
        return _applied(OPERATORS[type(node.op)], [node.left, node.right])
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in OPERATORS:
        return _applied(OPERATORS[type(node.ops[0])], [node.left, node.comparators[0]])
    if isinstance(node, ast.IfExp):
        return _applied(np.where, [node.test, node.body, node.orelse])
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in FUNCTIONS and not node.keywords:
        count, function = FUNCTIONS[node.func.id]
        if len(node.args) == count and not any(isinstance(each, ast.Starred) for each in node.args):
            return _applied(function, node.args)
        raise SettingsError(f'"{node.func.id}" takes {count} {"number" if count == 1 else "numbers"} in a formula, not {len(node.args)}.')
    raise SettingsError(f'A formula may not hold "{_short(ast.unparse(node))}"; it takes {_words()}.')


def _named(name: str) -> Function:
    if name in CONSTANTS:
        number = CONSTANTS[name]
        return lambda _given: number
    if name in NAMES:
        return lambda given: given[name]
    raise SettingsError(f'A formula knows no "{_short(name)}"; it takes {_words()}.')


def _applied(function: Callable[..., Value], nodes: list[ast.expr]) -> Function:
    arguments = [_read(node) for node in nodes]
    return lambda given: _as_numbers(function(*(argument(given) for argument in arguments)))


def _as_numbers(value: Value) -> Value:
    """Truths count as 0 and 1."""
    return value * 1.0 if np.asarray(value).dtype.kind == "b" else value


def _whole(values: Value) -> np.ndarray:
    """Numbers rounded down to whole ones, as bits."""
    return np.nan_to_num(np.clip(np.floor(values), -MOST_OF_WHOLE, MOST_OF_WHOLE)).astype(np.int64)


def _words() -> str:
    return f"{', '.join(NAMES)}, {', '.join(CONSTANTS)}, numbers, + - * / // % ** < > ( ), a if b else c, and {', '.join(FUNCTIONS)}"


def _short(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."
