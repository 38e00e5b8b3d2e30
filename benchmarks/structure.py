"""How the house is built, in figures: ``python -m benchmarks.structure`` prints the table.

How long quick tests took is of the last ``make test`` in this clone, the mutants are those of the
last ``make mutation``; the rest is measured now.
"""

from __future__ import annotations

import ast
import csv
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from tokenize import COMMENT, DEDENT, ENCODING, ENDMARKER, INDENT, NEWLINE, NL, tokenize
from xml.etree import ElementTree

import grimp
import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from benchmarks.mutation import MUTANT_COUNT

ROOT = Path(__file__).parents[1]
ROOMS = ("app", "calib", "drivers", "protocols")
FLAT = {"__init__", "__main__", "cli", "exit_codes", "settings", "version"}
"""What may stand in `app` outside a room."""


WORDS = (
    "found one said told held own known asked shown given other left rest it them taken wanted "
    "made seen kept every some both each more most whole these those that this others another same "
    "chosen named done used read written lost sent heard needed put missed met tried believed got "
    "ones none which what who whose mine ours theirs either somebody nobody everybody anything "
    "something nothing everything gone came brought took gave stood answered offered proposed "
    "picked solved observed visited"
)
PLAIN = "of many words allowed there thing meant stated drawn beside before after"
"""What a test may say, which compares the words and the state before and after."""

NO_NOUNS = frozenset([*WORDS.split(), *PLAIN.split()])
"""Participles and pronouns, which say nothing of what a value is."""

SESSION = ROOT / "sample_sessions" / "simulated_two-station.jsonl"
QUICK_TESTS = ROOT / "build" / "quick-tests.xml"
MUTANTS = ROOT / "docs" / "mutants.csv"

ENTERED = """
import sys
from pathlib import Path

rooms = tuple(str(Path({root!r}, room)) for room in {rooms!r})
codes, deep, deepest = set(), 0, 0

def note(frame, event, _):
    global deep, deepest
    code = frame.f_code
    if not code.co_filename.startswith(rooms) or code.co_name.startswith("<"):
        return
    if not code.co_flags & 1:  # a module or the body of a class
        return
    if event == "call":
        codes.add(code)
        deep += 1
        deepest = max(deepest, deep)
    elif event == "return":
        deep -= 1

from app.cli import main
sys.argv = ["glidecal", *{arguments!r}]
sys.setprofile(note)
try:
    main()
except SystemExit:
    pass
sys.setprofile(None)
print(len(codes), deepest, file=sys.stderr)
"""


@dataclass(frozen=True)
class Structure:
    """``largest_cycle`` counts modules; ``lines`` are those of each room, blank ones too."""

    modules: int
    imports_a_module: float
    largest_cycle: tuple[str, ...]
    numpy_in_app: tuple[str, ...]
    flat_in_app: tuple[str, ...]
    lines: dict[str, int]


def structure() -> Structure:
    """Measured from the imports of every module, those inside functions included."""
    graph = grimp.build_graph(*ROOMS, include_external_packages=True, cache_dir=None)
    modules = sorted(m for m in graph.modules if m.split(".")[0] in ROOMS)
    number = {module: k for k, module in enumerate(modules)}
    edges = [
        (number[m], number[module])
        for m in modules
        for module in graph.find_modules_directly_imported_by(m)
        if module in number
    ]
    arrays = ["numpy", "scipy"]
    users = {
        m
        for array_library in arrays
        for m in graph.find_modules_that_directly_import(array_library)
    }
    return Structure(
        modules=len(modules),
        imports_a_module=len(edges) / len(modules),
        largest_cycle=_largest_cycle(modules, edges),
        numpy_in_app=tuple(sorted(m for m in users if m.startswith("app."))),
        flat_in_app=tuple(
            sorted(path.stem for path in (ROOT / "app").glob("*.py") if path.stem not in FLAT)
        ),
        lines=_lines(),
    )


def _largest_cycle(modules: list[str], edges: list[tuple[int, int]]) -> tuple[str, ...]:
    """The largest set of modules that all lead to each other; empty where there is none."""
    rows, columns = zip(*edges, strict=True)
    square = csr_array((np.ones(len(edges)), (rows, columns)), shape=(len(modules),) * 2)
    _, label = connected_components(square, connection="strong")
    largest = np.flatnonzero(label == np.bincount(label).argmax())
    return tuple(modules[k] for k in largest) if len(largest) > 1 else ()


def _lines() -> dict[str, int]:
    """Lines of each folder with modules in it, the four rooms as a whole first."""
    files = {path: path.read_text(encoding="utf-8").count("\n") for path in _python_files()}
    folders = sorted({path.parent for path in files})
    lines = {room: sum(n for p, n in files.items() if ROOT / room in p.parents) for room in ROOMS}
    details = {
        folder.relative_to(ROOT).as_posix() + "/": sum(
            n for p, n in files.items() if p.parent == folder
        )
        for folder in folders
    }
    return lines | details


def names_of(tree: ast.AST) -> Iterator[str]:
    """Names of values and arguments, where they are given a value."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id.strip("_")
        elif isinstance(node, ast.arg):
            yield node.arg.strip("_")


def code_lines(text: str) -> int:
    """Lines without blank ones, comments and docstrings."""
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    of_words: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        for statement in node.body if isinstance(node, documented) else ():
            if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
                of_words.update(range(statement.lineno, (statement.end_lineno or 0) + 1))
    kinds = {COMMENT, DEDENT, ENCODING, ENDMARKER, INDENT, NEWLINE, NL}
    tokens = tokenize(BytesIO(text.encode()).readline)
    lines = {
        line
        for token in tokens
        if token.type not in kinds
        for line in range(token.start[0], token.end[0] + 1)
    }
    return len(lines - of_words)


def core_modules() -> frozenset[str]:
    """What measure, solve, diagnose and export of tripods import: the contract's, and all below."""
    graph = grimp.build_graph(*ROOMS, cache_dir=None)
    first = ("app.evaluating.diagnosis", "app.measuring.session", "app.exports")
    return frozenset(first) | {m for name in first for m in graph.find_upstream_modules(name)}


def entered(*arguments: str) -> tuple[int, int]:
    """Functions of the rooms that a command enters, and how deep."""
    script = ENTERED.format(root=str(ROOT), rooms=ROOMS, arguments=arguments)
    process = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT
    )
    functions, deepest = process.stderr.splitlines()[-1].split()
    return int(functions), int(deepest)


def bare_data_classes(tree: ast.Module) -> int:
    """Data classes that carry values and nothing that is worked out of them."""
    classes = (node for node in ast.walk(tree) if isinstance(node, ast.ClassDef))
    return sum(
        any("dataclass" in ast.unparse(decorator) for decorator in node.decorator_list)
        and not any(isinstance(part, ast.FunctionDef) for part in node.body)
        for node in classes
    )


def processor_s(*arguments: str) -> float:
    """Of a whole process of Python, the least of three."""
    times = []
    for _ in range(3):
        before = os.times()
        subprocess.run([sys.executable, *arguments], capture_output=True, check=True, cwd=ROOT)
        after = os.times()
        of_system = after.children_system - before.children_system
        times.append(after.children_user - before.children_user + of_system)
    return min(times)


def quick_tests_s() -> str:
    """How long they took as `make test` ran last."""
    if not QUICK_TESTS.exists():
        return "not run"
    [suite] = ElementTree.parse(QUICK_TESTS).iter("testsuite")
    return f"{float(suite.attrib['time']):.0f}"


def mutants_seen() -> str:
    """Of the mutants that change what the program does, those that tests see."""
    with MUTANTS.open(encoding="utf-8", newline="") as file:
        outcomes = [row["outcome"] for row in csv.DictReader(file)]
    effective = MUTANT_COUNT - outcomes.count("no effect")
    seen = effective - outcomes.count("not seen")
    return f"{seen} of {effective}, {seen / effective:.0%}"


def _python_files() -> list[Path]:
    return [path for room in ROOMS for path in (ROOT / room).rglob("*.py")]


def _module(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def _share(names: list[str]) -> float:
    return sum(name in NO_NOUNS for name in names) / len(names)


def table(result: Structure) -> str:
    """The figures as a table in Markdown."""
    with TemporaryDirectory() as folder:
        to_json = ("--format", "json", "-o", f"{folder}/offsets.json")
        export = entered("export", str(SESSION), *to_json)
        diagnose = entered("diagnose", str(SESSION))
    texts = {path: path.read_text(encoding="utf-8") for path in _python_files()}
    trees = [ast.parse(text) for text in texts.values()]
    names = [name for tree in trees for name in names_of(tree)]
    core = core_modules()
    of_core = {path: text for path, text in texts.items() if _module(path) in core}
    rows = [
        ("names that are participles or pronouns", f"{_share(names):.1%}"),
        ("functions that `export` enters, and how deep", "{}, {}".format(*export)),
        ("functions that `diagnose` enters, and how deep", "{}, {}".format(*diagnose)),
        ("lines of code", f"{sum(map(code_lines, texts.values())):,}"),
        ("– of the core", f"{sum(map(code_lines, of_core.values())):,}"),
        ("data classes without a method", f"{sum(map(bare_data_classes, trees))}"),
        ("quick tests, s", quick_tests_s()),
        ("mutants that tests see", mutants_seen()),
        ("processor for `import glidecal`, s", f"{processor_s('-c', 'import glidecal'):.2f}"),
        ("processor for `--help`, s", f"{processor_s('-m', 'app', '--help'):.2f}"),
        ("processor for `solve`, s", f"{processor_s('-m', 'app', 'solve', str(SESSION)):.2f}"),
        ("modules", f"{result.modules}"),
        ("imports a module", f"{result.imports_a_module:.2f}"),
        ("largest import cycle, modules", f"{max(len(result.largest_cycle), 1)}"),
        ("modules of `app` that import numpy or scipy", f"{len(result.numpy_in_app)}"),
        ("lines of the four rooms", f"{sum(result.lines[room] for room in ROOMS):,}"),
        *((f"`{room}`", f"{lines:,}") for room, lines in result.lines.items()),
    ]
    return "\n".join(["| what | figure |", "|---|---|", *(f"| {a} | {b} |" for a, b in rows)])


if __name__ == "__main__":
    print(table(structure()))
