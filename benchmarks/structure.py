"""How the house is built, in figures: ``python -m benchmarks.structure`` prints the table."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import grimp
import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

ROOT = Path(__file__).parents[1]
ROOMS = ("app", "calib", "drivers", "protocols")
FLAT = {"__init__", "__main__", "cli", "exit_codes", "settings", "version"}
"""What may stand in `app` outside a room."""


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


def _python_files() -> list[Path]:
    return [path for room in ROOMS for path in (ROOT / room).rglob("*.py")]


def table(result: Structure) -> str:
    """The figures as a table in Markdown."""
    rows = [
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
