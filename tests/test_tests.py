"""Tests ask what is public, and every one of them can fail."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

HERE = Path(__file__).parent
FOREIGN = {"_compositor", "_notifications", "_filters", "_exit", "_repr_html_"}
"""Of Textual, which has no public door to rows, notices and colours as they are shown; of os; of
Jupyter."""

FAILS = {"raises", "warns", "fail"}  # of pytest
Function = ast.FunctionDef | ast.AsyncFunctionDef


def modules() -> dict[str, ast.Module]:
    return {
        ".".join(path.relative_to(HERE.parent).with_suffix("").parts): ast.parse(path.read_bytes())
        for path in sorted(HERE.rglob("*.py"))
    }


def is_private(name: str) -> bool:
    return any(
        part.startswith("_") and not (part.startswith("__") and part.endswith("__"))
        for part in name.split(".")
    )


def named(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Names reached from outside, also those that are patched by a string."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] != "textual":
            yield from ((node.lineno, f"{node.module}.{alias.name}") for alias in node.names)
        elif isinstance(node, ast.Attribute):
            yield node.lineno, node.attr
        elif isinstance(node, ast.Call) and last_name(node.func) in ("setattr", "getattr", "patch"):
            texts = (argument.value for argument in node.args if isinstance(argument, ast.Constant))
            yield from ((node.lineno, text) for text in texts if isinstance(text, str))


@cache
def defined(tree: ast.Module) -> set[str]:
    """Functions, and attributes that this file's own classes give themselves or state."""
    names, fields = set(), set()
    for node in ast.walk(tree):
        if isinstance(node, Function):
            names.add(node.name)
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            if isinstance(node.value, ast.Name) and node.value.id == "self":
                names.add(node.attr)
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            fields.add(node.target.id)
    return names | fields


def last_name(called: ast.expr) -> str:
    return called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")


def test_no_private_name_is_reached() -> None:
    places = [
        f"{module}:{line} {name}"
        for module, tree in modules().items()
        for line, name in named(tree)
        if is_private(name) and name not in FOREIGN and name not in defined(tree)
    ]
    assert places == []


def test_every_test_can_fail() -> None:
    """By an assertion, by what it expects to be raised, or in a helper of the tests that does."""
    trees = modules()
    functions = {
        (module, node.name): node
        for module, tree in trees.items()
        for node in ast.walk(tree)
        if isinstance(node, Function)
    }
    imports = {module: imported(module, tree) for module, tree in trees.items()}
    failing = {place for place, function in functions.items() if fails_itself(function)}
    called = {place: calls(function, imports[place[0]]) for place, function in functions.items()}
    while callers := {
        place for place in called if place not in failing and called[place] & failing
    }:
        failing |= callers
    tests = [place for place in functions if place[1].startswith("test_")]
    assert len(tests) > 1000
    assert [place for place in tests if place not in failing] == []


def imported(module: str, tree: ast.Module) -> dict[str, tuple[str, str]]:
    """What a name of this file is: the file and the name there."""
    functions = {
        function.name: (module, function.name)
        for function in ast.walk(tree)
        if isinstance(function, Function)
    }
    imports = (statement for statement in ast.walk(tree) if isinstance(statement, ast.ImportFrom))
    return functions | {
        alias.asname or alias.name: (node.module or "", alias.name)
        for node in imports
        for alias in node.names
    }


def fails_itself(function: Function) -> bool:
    return any(
        isinstance(node, ast.Assert)
        or (isinstance(node, ast.Call) and can_fail(last_name(node.func)))
        for node in ast.walk(function)
    )


def can_fail(name: str) -> bool:
    return name in FAILS or name.startswith("assert_")  # the last of numpy


def calls(function: Function, imports: dict[str, tuple[str, str]]) -> set[tuple[str, str]]:
    names = (last_name(node.func) for node in ast.walk(function) if isinstance(node, ast.Call))
    return {imports[name] for name in names if name in imports}
