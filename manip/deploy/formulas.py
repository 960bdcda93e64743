"""Formulas over named measurements, as text: observations of an exported policy.

`clip(10.0 * (cube_pos - eef_pos), -5.0, 5.0)`: arithmetic, indices and `FUNCTIONS`, in
Python's notation. Nothing else is accepted, and no code is run.
"""

import ast
import operator
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

LONGEST, DEEPEST = 6000, 60
"""Most characters of a formula, and most levels of it."""

OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul,
    ast.Div: operator.truediv, ast.MatMult: operator.matmul, ast.USub: operator.neg,
    ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt,
    ast.GtE: operator.ge, ast.Eq: operator.eq, ast.NotEq: operator.ne,
    ast.BitAnd: operator.and_, ast.BitOr: operator.or_, ast.Invert: operator.invert,
}  # fmt: skip
FUNCTIONS: dict[str, Callable[..., Any]] = {
    "abs": np.abs, "all": np.all, "any": np.any, "arctan2": np.arctan2,
    "clip": np.clip, "concat": lambda *parts: np.concatenate(parts), "cos": np.cos,
    "cross": np.cross, "exp": np.exp, "hypot": np.hypot,
    "matrix": lambda x: np.reshape(x, (3, 3)), "maximum": np.maximum,
    "mean": np.mean, "minimum": np.minimum, "norm": np.linalg.norm,
    "round": np.round, "sin": np.sin, "sqrt": np.sqrt,
    "stack": lambda *parts: np.stack(parts), "sum": np.sum,
    "tanh": np.tanh, "vector": np.atleast_1d, "where": np.where,
}  # fmt: skip


def parse_formula(text: str) -> ast.expr:
    """Parse a formula over named measurements: arithmetic and `FUNCTIONS` only.

    Raises:
        ValueError: it is no formula.
    """
    try:
        tree = ast.parse(text[: LONGEST + 1], mode="eval").body
        _check(tree, 0)
    except (SyntaxError, MemoryError, RecursionError, TypeError) as error:
        raise ValueError(f"no formula: {text[:50]!r}") from error
    if len(text) > LONGEST:
        raise ValueError(f"a formula has at most {LONGEST} characters")
    return tree


def _check(node: Any, depth: int) -> None:
    """Raise TypeError for anything but arithmetic on numbers and measurements."""
    match node:
        case ast.Call(func=ast.Name(id=name), args=parts, keywords=[]):
            known = name in FUNCTIONS
        case ast.BinOp(left=left, op=op, right=right):
            known, parts = type(op) in OPERATORS, [left, right]
        case ast.Compare(left=left, ops=[op], comparators=[right]):
            known, parts = type(op) in OPERATORS, [left, right]
        case ast.UnaryOp(op=op, operand=operand):
            known, parts = type(op) in OPERATORS, [operand]
        case ast.Subscript(value=value, slice=ast.Slice(lower, upper, None)):
            known, parts = True, [value, *(e for e in (lower, upper) if e)]
        case ast.Subscript(value=value, slice=index):
            known, parts = True, [value, index]
        case ast.List(elts=parts):
            known = True
        case ast.Name():
            known, parts = True, []
        case ast.Constant(value=number):
            known, parts = type(number) in (int, float), []
        case _:
            known, parts = False, []
    if not known or depth > DEEPEST:
        raise TypeError
    for part in parts:
        _check(part, depth + 1)


def evaluate(node: Any, values: Mapping[str, Any]) -> Any:
    """The value of a parsed formula for measurements, name -> number or [k]."""
    match node:
        case ast.Name(id=name):
            return values[name]
        case ast.Constant(value=number):
            return number
        case ast.List(elts=items):
            return np.array([evaluate(item, values) for item in items])
        case ast.Call(func=ast.Name(id=name), args=parts):
            return FUNCTIONS[name](*(evaluate(part, values) for part in parts))
        case ast.BinOp(left=left, op=op, right=right):
            return OPERATORS[type(op)](evaluate(left, values), evaluate(right, values))
        case ast.Compare(left=left, ops=[op], comparators=[right]):
            return OPERATORS[type(op)](evaluate(left, values), evaluate(right, values))
        case ast.UnaryOp(op=op, operand=operand):
            return OPERATORS[type(op)](evaluate(operand, values))
        case ast.Subscript(value=value, slice=ast.Slice(lower, upper)):
            ends = (end and evaluate(end, values) for end in (lower, upper))
            return evaluate(value, values)[slice(*ends)]
        case _:
            return evaluate(node.value, values)[evaluate(node.slice, values)]
