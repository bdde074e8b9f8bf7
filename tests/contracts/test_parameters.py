"""A function has few positional parameters: more would be confused with each other and belong into a named tuple."""

from __future__ import annotations

import ast
from pathlib import Path

MOST = 8
COMPILED = {"compiled", "python_first", "equation"}  # numba takes arrays and floats faster than tuples of them


def crowded(tree: ast.Module) -> list[str]:
    """Functions and methods of more than MOST positional parameters, without self and cls, that are not compiled."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            names = [a.arg for a in (*node.args.posonlyargs, *node.args.args) if a.arg not in ("self", "cls")]
            if len(names) > MOST and not COMPILED & {ast.unparse(d).partition("(")[0] for d in node.decorator_list}:
                found.append(f"{node.name}({', '.join(names)})")
    return found


def test_functions_of_many_parameters_take_named_tuples(root: Path) -> None:
    for folder in ("fusion_sfdia", "models", "benchmarks"):
        for path in sorted((root / folder).rglob("*.py")):
            assert not (found := crowded(ast.parse(path.read_text(encoding="utf-8")))), f"{path.name}: {found}"


def test_what_counts_as_many() -> None:
    eight, nine = ", ".join("abcdefgh"), ", ".join("abcdefghi")
    few = f"class A:\n def f(self, {eight}, *, i): ...\n@equation\ndef g({nine}): ...\n@compiled\ndef h({nine}): ..."
    assert crowded(ast.parse(few)) == []
    assert crowded(ast.parse(f"def f({nine}): ...")) == [f"f({nine})"]
