"""Small errors in `calib` and `protocols` that no test sees: ``make mutation``.

Cosmic Ray makes the mutants. One is drawn for a place in a file, so that an operator with eleven
replacements weighs no more than a number, and of these a sample. Each is tried in a process of its
own, in a copy of this house in FOLDER, by the quick tests that reach its line, until one fails.
FOLDER keeps which test reaches which line (``reach*.json``) and the outcomes (``outcomes.jsonl``):
a run that was interrupted continues. ``--reach calib/test_stats.py --again`` tries once more what
was not killed, after these tests of `tests` became better.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import functools
import hashlib
import importlib
import json
import os
import shutil
import signal
import sys
import time
import traceback
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from compileall import compile_dir
from dataclasses import asdict, dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MUTATED = ("calib", "protocols")
FIRST = ("calib/posterior", "calib/diagnosis", "calib/design", "calib/identify")
"""Tried first: what decides on names, bounds and the next measurement."""

TESTS = (
    *("calib", "protocols", "app/evaluating", "app/commands", "app/exports", "app/measuring"),
    *("app/report", "test_docs_printer.py", "test_walk.py"),
)
QUICK = ("-m", "not long", "-p", "no:cacheprovider", "-p", "no:xdist", "-q")
SEED = 33
MUTANT_COUNT = 300
LIMIT_S = 30.0
"""Of tests that a mutant is tried by, and three times as long until these hang."""

LEFT_OUT = (".git", ".venv", "build", "*.egg-info", ".mypy_cache", ".hypothesis", ".ruff_cache")
SLOW_IMPORTS = ("numpy", "scipy.optimize", "scipy.stats", "scipy.linalg", "pydantic")
"""Imported once, before the processes of the mutants part."""

OUTCOMES = {0: "survived", 1: "killed", 2: "killed", None: "hung"}
"""By the status of pytest: a test failed, or its module could not be imported."""


@dataclass(frozen=True, order=True)
class Mutant:
    """``occurrence`` of a Cosmic Ray operator in a file."""

    path: str
    line: int
    column: int
    operator: str
    occurrence: int


def sample(count: int) -> list[Mutant]:
    """Fixed by the text of lines: a change elsewhere leaves a mutant in the sample or out of it.

    Annotations of functions, which nothing evaluates, have none.
    """
    places: dict[tuple[str, int, int], list[tuple[str, Mutant]]] = defaultdict(list)
    for mutant, line in _mutants():
        places[mutant.path, mutant.line, mutant.column].append(
            (_drawn(*line, mutant.column, mutant.operator), mutant)
        )
    by_place = [
        (_drawn(min(there)[0], path), min(there)[1]) for (path, _, _), there in places.items()
    ]
    mutants = [mutant for _, mutant in sorted(by_place)[:count]]
    return sorted(mutants, key=lambda mutant: not mutant.path.startswith(FIRST))


def _drawn(*what: object) -> str:
    """By chance, and always the same."""
    return hashlib.sha256(repr((SEED, *what)).encode()).hexdigest()


def _mutants() -> Iterator[tuple[Mutant, tuple[str, int]]]:
    """All, each with the text of its line, and how often it was in the file before."""
    from cosmic_ray.ast import ast_nodes, get_ast
    from cosmic_ray.plugins import get_operator, operator_names

    kinds = [(name, get_operator(name)) for name in operator_names()]
    operators = [(name, kind()) for name, kind in kinds if not kind.arguments()]
    for path in sorted(path for room in MUTATED for path in (ROOT / room).rglob("*.py")):
        house_path, source = str(path.relative_to(ROOT)), path.read_text(encoding="utf-8")
        nodes = list(ast_nodes(get_ast(source)))
        hints = list(annotation_spans(ast.parse(source)))
        texts = [line.strip() for line in source.splitlines()]
        lines = [(text, texts[:number].count(text)) for number, text in enumerate(texts)]
        for name, operator in operators:
            spots = [spot for node in nodes for spot in operator.mutation_positions(node)]
            for occurrence, (start, end) in enumerate(spots):
                if not any(low <= start and end <= high for low, high in hints):
                    mutant = Mutant(house_path, start[0], start[1], name, occurrence)
                    yield mutant, lines[start[0] - 1]


def annotation_spans(tree: ast.Module) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """From where to where annotations go that are text only."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            arguments = node.args
            every = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
            extra = [one for one in (arguments.vararg, arguments.kwarg) if one is not None]
            hints = [node.returns, *(one.annotation for one in (*every, *extra))]
            inner = [line.annotation for line in ast.walk(node) if isinstance(line, ast.AnnAssign)]
            for hint in (*hints, *inner):
                if hint is not None:
                    # columns of ast count bytes; only names of types are in annotations
                    ends = (hint.end_lineno or hint.lineno, hint.end_col_offset or 0)
                    yield (hint.lineno, hint.col_offset), ends


class Reach:
    """Plugin of pytest: which test executes which line, and how long each takes."""

    def __init__(self, rooms: Path) -> None:
        import coverage

        self._coverage = coverage.Coverage(
            data_file=None, source=[str(rooms / room) for room in MUTATED], config_file=False
        )
        self._coverage.start()
        self._path = ""
        self.seconds: dict[str, float] = defaultdict(float)
        self.bad: set[str] = set()

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Caches of other files are emptied: what they keep is computed again, and seen."""
        path = nodeid.partition("::")[0]
        if path != self._path:
            self._path = path
            for name, module in list(sys.modules.items()):
                if name.partition(".")[0] in {"app", "tests", *MUTATED}:
                    for value in list(vars(module).values()):
                        if isinstance(value, functools._lru_cache_wrapper):
                            value.cache_clear()
        self._coverage.switch_context(nodeid)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Of set-up, test and end."""
        self.seconds[report.nodeid] += report.duration
        if not report.passed:
            self.bad.add(report.nodeid)

    def write(self, path: Path, rooms: Path) -> None:
        """As JSON, with tests as numbers."""
        self._coverage.stop()
        data = self._coverage.get_data()
        numbers = {name: number for number, name in enumerate(self.seconds)}
        lines = {
            str(Path(file).relative_to(rooms)): {
                line: [numbers[test] for test in tests if test in numbers and test not in self.bad]
                for line, tests in data.contexts_by_lineno(file).items()
            }
            for file in data.measured_files()
        }
        path.write_text(
            json.dumps({"seconds": self.seconds, "bad": sorted(self.bad), "lines": lines})
        )


def measure(copy: Path, path: Path, tests: Sequence[str]) -> None:
    """Run the quick tests once, and write what reaches what."""

    def inside() -> int:
        reach = Reach(copy)
        status = int(pytest.main([*QUICK, *(f"tests/{test}" for test in tests)], plugins=[reach]))
        reach.write(path, copy)
        return status

    _apart(inside, copy, path.with_suffix(".log"), 7200.0)


@dataclass
class LineTests:
    """Those that pass, with their time, and which reach a line of a file."""

    seconds: dict[str, float]
    reaching: dict[str, dict[int, set[str]]]

    @classmethod
    def read(cls, folder: Path) -> LineTests:
        """All that was measured there."""
        seconds: dict[str, float] = {}
        reaching: dict[str, dict[int, set[str]]] = {}
        for path in sorted(folder.glob("reach*.json")):
            part = json.loads(path.read_text())
            names = list(part["seconds"])
            seconds |= {name: s for name, s in part["seconds"].items() if name not in part["bad"]}
            for file, lines in part["lines"].items():
                there = reaching.setdefault(file, defaultdict(set))
                for line, tests in lines.items():
                    there[int(line)] |= {names[test] for test in tests}
        return cls(seconds, reaching)

    def of(self, mutant: Mutant, limit_s: float) -> list[str]:
        """Those that reach its line, or else its function or module; then others of their files.

        What a fixture or a cache computes is reached by the first test alone, hence the others.
        """
        reaching = self.reaching.get(mutant.path, {})
        first, last = function_lines(mutant)
        near = reaching.get(mutant.line, set())
        near = near or _union(tests for line, tests in reaching.items() if first <= line <= last)
        near = near or _union(reaching.values())
        cost_s: dict[str, float] = defaultdict(float)
        for name in near:
            cost_s[_file(name)] += self.seconds[name]

        def rank(name: str) -> tuple[bool, bool, float, str, float]:
            file = _file(name)
            other = Path(mutant.path).stem not in file
            return name not in near, other, cost_s[file], file, self.seconds[name]

        tests_of_mutant: list[str] = []
        total_s = 0.0
        for name in sorted((name for name in self.seconds if _file(name) in cost_s), key=rank):
            if not tests_of_mutant or total_s + self.seconds[name] <= limit_s:
                tests_of_mutant.append(name)
                total_s += self.seconds[name]
        return tests_of_mutant


def _file(test: str) -> str:
    return test.partition("::")[0]


def _union(sets: Iterable[set[str]]) -> set[str]:
    return set().union(*sets)


def function_lines(mutant: Mutant) -> tuple[int, int]:
    """First and last line of the innermost function around it, or of all."""
    tree = ast.parse((ROOT / mutant.path).read_text(encoding="utf-8"))
    spans = [
        (node.lineno, node.end_lineno or node.lineno)
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
    ]
    return max((span for span in spans if span[0] <= mutant.line <= span[1]), default=(0, 10**9))


def outcome(
    mutant: Mutant, copy: Path, tests: LineTests, log: Path, limit_s: float
) -> dict[str, str | float]:
    """What became of the mutant, and by which test; the copy is as before afterwards."""
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    path = copy / mutant.path
    original, before = path.read_text(encoding="utf-8"), path.stat()
    changed = mutate_code(original, get_operator(mutant.operator)(), mutant.occurrence)
    lines = zip(original.splitlines(), changed.splitlines(), strict=False)
    change = next((f"{old.strip()} → {new.strip()}" for old, new in lines if old != new), "")
    tests_of_mutant = tests.of(mutant, limit_s)
    row = {
        **asdict(mutant),
        "change": change,
        "tests": len(tests_of_mutant),
        "outcome": "not reached",
    }
    if not tests_of_mutant:
        return row
    longest_s = 60.0 + 3.0 * sum(tests.seconds[name] for name in tests_of_mutant)
    started = time.monotonic()
    try:
        path.write_text(changed, encoding="utf-8")
        status = _apart(lambda: _tested(tests_of_mutant), copy, log, longest_s)
        if status == pytest.ExitCode.USAGE_ERROR:  # names of tests depend on the change
            files = list(dict.fromkeys(map(_file, tests_of_mutant)))
            status = _apart(lambda: _tested(files), copy, log, longest_s)
    finally:
        path.write_text(original, encoding="utf-8")
        os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))  # its bytecode is good again
        shutil.rmtree(copy / ".hypothesis", ignore_errors=True)
    text = log.read_text(encoding="utf-8", errors="replace").splitlines()
    by = next((line for line in text if line.startswith(("FAILED", "ERROR"))), "")
    took_s = round(time.monotonic() - started, 1)
    return {**row, "outcome": OUTCOMES.get(status, f"status {status}"), "by": by, "took_s": took_s}


def _tested(names: list[str]) -> int:
    return int(pytest.main([*QUICK, "-x", "-rfE", "--tb=line", *names]))


def _apart(work: Callable[[], int], copy: Path, log: Path, limit_s: float) -> int | None:
    """Status of the work in a process of its own, at home in the copy; none if it hung."""
    child = os.fork()
    if child == 0:
        os.setpgid(0, 0)
        os.chdir(copy)
        sys.path[:] = [str(copy), *(place for place in sys.path if Path(place) != ROOT)]
        os.environ["PYTHONPATH"] = str(copy)
        with log.open("w", encoding="utf-8") as stream:
            os.dup2(stream.fileno(), 1)
            os.dup2(stream.fileno(), 2)
        status = 70
        try:
            status = work()
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(status)
    until = time.monotonic() + limit_s
    ended, status = 0, 0
    while not ended and time.monotonic() < until:
        ended, status = os.waitpid(child, os.WNOHANG)
        time.sleep(0.02)
    with contextlib.suppress(ProcessLookupError):  # also what a test left behind
        os.killpg(child, signal.SIGKILL)
    if ended:
        return os.waitstatus_to_exitcode(status)
    os.waitpid(child, 0)
    return None


def main() -> None:
    """Measure what reaches what, if need be; then try the mutants that have no outcome."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, default=MUTANT_COUNT)
    parser.add_argument("--limit", type=float, default=LIMIT_S, help="seconds of tests a mutant")
    parser.add_argument("--again", action="store_true", help="what was not killed, once more")
    parser.add_argument("--reach", nargs="*", help="new or changed tests: measure these first")
    arguments = parser.parse_args()
    folder: Path = arguments.folder.resolve()
    copy, outcomes = folder / "house", folder / "outcomes.jsonl"
    shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(*LEFT_OUT), dirs_exist_ok=True)
    compile_dir(copy, quiet=2)  # the file that is changed is compiled again each time
    for name in SLOW_IMPORTS:
        importlib.import_module(name)
    measured = len(list(folder.glob("reach*.json")))
    if arguments.reach or not measured:
        measure(copy, folder / f"reach{measured}.json", arguments.reach or TESTS)
    sys.dont_write_bytecode = True
    os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
    tests, latest = LineTests.read(folder), _latest(outcomes)
    for mutant in sample(arguments.count):
        before = latest.get(mutant)
        if before is None or (arguments.again and before != "killed"):
            row = outcome(mutant, copy, tests, folder / "mutant.log", arguments.limit)
            with outcomes.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(row, ensure_ascii=False) + "\n")
    latest = _latest(outcomes)
    print(Counter(latest.values()))
    for mutant, word in latest.items():
        if word != "killed":
            print(f"{mutant.path}:{mutant.line}:{mutant.column} {mutant.operator} {word}")


def _latest(outcomes: Path) -> dict[Mutant, str]:
    text = outcomes.read_text(encoding="utf-8") if outcomes.exists() else ""
    rows = [json.loads(line) for line in text.splitlines()]
    return {Mutant(*(row[name] for name in Mutant.__match_args__)): row["outcome"] for row in rows}


if __name__ == "__main__":
    main()
