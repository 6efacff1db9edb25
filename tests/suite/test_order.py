"""No program and no text depends on the order of a set, which differs from process to process.

The order of a set of strings follows Python's hash seed. A cost that summed over one was another
program in each process: compiled anew at each start, with other last digits.
"""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ORDERED = {"list", "tuple", "enumerate", "zip", "iter", "next", "map", "join", "array", "stack"}
"""Functions whose result has the order of what they are given."""


def is_set(node: ast.AST) -> bool:
    """Check whether an expression is seen to be a set."""
    if isinstance(node, ast.Set | ast.SetComp):
        return True
    if isinstance(node, ast.BinOp):
        return isinstance(node.op, ast.BitAnd | ast.BitOr | ast.Sub | ast.BitXor) and (
            is_set(node.left) or is_set(node.right)
        )
    if not isinstance(node, ast.Call):
        return False
    names = {"set", "frozenset"}
    methods = {"intersection", "union", "difference", "symmetric_difference"}
    if isinstance(node.func, ast.Attribute):
        return node.func.attr in methods and is_set(node.func.value)
    return isinstance(node.func, ast.Name) and node.func.id in names


def ordered_sets(tree: ast.AST) -> Iterator[int]:
    """Yield the lines where the order of a set matters."""
    sorts = {
        id(argument)
        for call in ast.walk(tree)
        if isinstance(call, ast.Call)
        and isinstance(call.func, ast.Name)
        and call.func.id in ("sorted", "set", "frozenset", "any", "all", "min", "max", "len")
        for argument in call.args
    }
    for node in ast.walk(tree):
        found: list[ast.AST] = []
        if isinstance(node, ast.For):
            found = [node.iter]
        # What is made of a comprehension over a set may be ordered afterwards, or be a set.
        elif isinstance(node, ast.ListComp | ast.GeneratorExp | ast.DictComp):
            found = [] if id(node) in sorts else [each.iter for each in node.generators]
        elif isinstance(node, ast.Starred):
            found = [node.value]
        elif isinstance(node, ast.Call):
            name = getattr(node.func, "attr", getattr(node.func, "id", ""))
            found = list(node.args) if name in ORDERED and id(node) not in sorts else []
        yield from (node.lineno for each in found if is_set(each))


@pytest.mark.parametrize("room", ["src", "benchmarks", "docs", "tests"])
def test_nothing_has_the_order_of_a_set(room: str) -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}"
        for path in sorted((ROOT / room).rglob("*.py"))
        if ".peers" not in path.parts
        for line in ordered_sets(ast.parse(path.read_text(encoding="utf-8")))
    ]
    assert not found, found


@pytest.mark.parametrize(
    ("text", "is_ordered"),
    [
        ("for name in {'a', 'b'} & set(names): f(name)", True),
        ("x = [f(name) for name in set(names)]", True),
        ("x = tuple({a for a in names})", True),
        ("x = ', '.join(set(a) - set(b))", True),
        ("x = {name: 1 for name in frozenset(names)}", True),
        ("f(*set(names))", True),
        ("for name in sorted({'a', 'b'}): f(name)", False),
        ("x = sorted(f(name) for name in set(names))", False),
        ("x = {f(name) for name in set(names)}", False),
        ("x = 'a' in {'a', 'b'}", False),
        ("x = len(set(names))", False),
    ],
)
def test_the_order_of_a_set_is_seen(text: str, is_ordered: bool) -> None:
    assert bool(list(ordered_sets(ast.parse(text)))) == is_ordered
