"""Draws mutants of Python modules: one operator, constant or function of a module is replaced by another one.

What only refuses bad input or words a message is left out, because neither the oracle nor a hard case looks at it: `raise`
and `assert`, an `if` whose body only raises, docstrings, annotations and decorators.
"""

from __future__ import annotations

import ast
import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from spec.errors import InputError

_COMPARISONS: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq}
_OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Add, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult, ast.Mod: ast.Add,
    ast.LShift: ast.RShift, ast.RShift: ast.LShift, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.BitXor: ast.BitOr}
_FUNCTIONS = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "floor": "ceil", "ceil": "floor",
              "any": "all", "all": "any", "argmin": "argmax", "argmax": "argmin"}


@dataclass(frozen=True)
class SourceMutant:
    """A mutant.

    Attributes:
        path: the module's file, from the project's folder on.
        line: the line of the original that is changed.
        words: what is changed.
        number: which of the module's sites it is.
    """

    path: str
    line: int
    words: str
    number: int


Change = tuple[ast.AST, str, Callable[[], None]]
"""A node, in words how it can be changed, and what changes it in place."""


def _change(node: ast.AST) -> tuple[str, Callable[[], None]] | None:
    """How a node can be changed, if it can be."""
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in _COMPARISONS:
        other = _COMPARISONS[type(node.ops[0])]
        return _named(node.ops[0], other), lambda: node.ops.__setitem__(0, other())
    if isinstance(node, ast.BinOp | ast.AugAssign) and type(node.op) in _OPERATORS:
        operator = _OPERATORS[type(node.op)]
        return _named(node.op, operator), lambda: setattr(node, "op", operator())
    if isinstance(node, ast.BoolOp):
        joint = ast.Or if isinstance(node.op, ast.And) else ast.And
        return _named(node.op, joint), lambda: setattr(node, "op", joint())
    if isinstance(node, ast.UnaryOp) and not isinstance(node.op, ast.UAdd):
        return f"no {type(node.op).__name__}", lambda: setattr(node, "op", ast.UAdd())
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        value = node.value + 1 if type(node.value) is int else node.value * 1.01 or 0.01
        return f"{node.value!r} to {value!r}", lambda: setattr(node, "value", value)
    if isinstance(node, ast.Constant) and isinstance(node.value, bool):
        return f"{node.value!r} to {not node.value!r}", lambda: setattr(node, "value", not node.value)
    if isinstance(node, ast.Attribute) and node.attr in _FUNCTIONS:
        return f"{node.attr} to {_FUNCTIONS[node.attr]}", lambda: setattr(node, "attr", _FUNCTIONS[node.attr])
    if isinstance(node, ast.Name) and node.id in _FUNCTIONS:
        return f"{node.id} to {_FUNCTIONS[node.id]}", lambda: setattr(node, "id", _FUNCTIONS[node.id])
    return None


def _named(old: ast.AST, new: type[ast.AST]) -> str:
    return f"{type(old).__name__} to {new.__name__}"


def _refuses(node: ast.AST) -> bool:
    """Whether a node only refuses bad input."""
    if isinstance(node, ast.If) and not node.orelse:
        return all(isinstance(each, ast.Raise) for each in node.body)
    return isinstance(node, ast.Raise | ast.Assert)


def _parts(node: ast.AST) -> Iterator[ast.AST]:
    """The nodes below a node whose faults change what is computed."""
    hidden: list[ast.AST] = []
    if isinstance(node, ast.FunctionDef):
        hidden = [*node.decorator_list, *([node.returns] if node.returns else [])]
    elif isinstance(node, ast.ClassDef):
        hidden = list(node.decorator_list)
    elif isinstance(node, ast.AnnAssign):
        hidden = [node.annotation]
    elif isinstance(node, ast.arg):
        return
    for part in ast.iter_child_nodes(node):
        if not _refuses(part) and not isinstance(part, ast.JoinedStr) and not any(part is each for each in hidden):
            yield part


def sites(tree: ast.AST) -> list[Change]:
    """All changes of a module, in the order of its text."""
    found: list[Change] = []
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        change = _change(node)
        if change:
            found.append((node, *change))
        waiting += list(_parts(node))[::-1]
    return found


def draw(paths: Sequence[str], count: int, seed: int, root: Path) -> list[SourceMutant]:
    """Draws mutants of modules, every site with the same chance.

    Args:
        paths: the modules' files, from `root` on.
        count: how many; InputError where there are fewer sites.
    """
    every = [SourceMutant(path, node.lineno, words, number)
             for path in paths for number, (node, words, _) in enumerate(sites(ast.parse((root / path).read_text())))]
    if not 1 <= count <= len(every):
        raise InputError(f"{count} mutants are not accepted: 1 to {len(every)} are")
    return sorted(random.Random(seed).sample(every, count), key=lambda mutant: (mutant.path, mutant.number))


def mutated(text: str, mutant: SourceMutant) -> str:
    """The text of a module with a mutant in it."""
    tree = ast.parse(text)
    sites(tree)[mutant.number][2]()
    return ast.unparse(tree) + "\n"
