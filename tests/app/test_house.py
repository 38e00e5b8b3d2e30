"""The rooms: what each may know, and what start-up may import."""

from __future__ import annotations

import subprocess
import sys
import tomllib

import pytest

from tests.conftest import ROOT

ROOMS = ("app", "calib", "drivers", "protocols")


def imported(code: str) -> set[str]:
    """Top-level names of the modules that a fresh interpreter holds after this code."""
    script = f"{code}\nimport sys\nprint(*{{name.split('.')[0] for name in sys.modules}})"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=60
    )
    return set(done.stdout.split())


def modules(room: str) -> str:
    paths = (ROOT / room).rglob("*.py")
    names = [".".join(p.relative_to(ROOT).with_suffix("").parts) for p in paths]
    return "import " + ", ".join(name.removesuffix(".__init__") for name in sorted(names))


@pytest.mark.parametrize(
    ("room", "unknown"),
    [
        (
            "calib",
            {"pydantic", "serial", "textual", "typer", "rich", *ROOMS} - {"calib"},
        ),
        ("drivers", {"pydantic", "numpy", "textual", "typer", "rich", "app", "protocols"}),
        ("protocols", {"serial", "textual", "typer", "rich", "app", "drivers"}),
    ],
)
def test_a_room_pulls_in_nothing_it_must_not_know(room: str, unknown: set[str]) -> None:
    assert imported(modules(room)) & unknown == set()


def test_every_top_level_package_is_in_the_contract() -> None:
    """The layers are exhaustive: a new room must be placed in pyproject.toml."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    linter = settings["tool"]["importlinter"]
    layers = {
        name.strip() for layer in linter["contracts"][0]["layers"] for name in layer.split("|")
    }
    around = {"tests", "benchmarks", "studies"}
    packages = {p.parent.name for p in ROOT.glob("*/__init__.py")} - around
    assert packages == layers == set(linter["root_packages"]) == set(ROOMS)


def test_help_imports_nothing_heavy() -> None:
    heavy = {"numpy", "scipy", "pydantic", "textual", "serial"}
    assert imported("import app.cli") & heavy == set()


def test_solve_does_not_load_scipy_stats_or_textual() -> None:
    code = "import app.evaluating.solution, app.report.text.result, sys\n"
    code += "assert 'scipy.stats' not in sys.modules"
    assert not imported(code) & {"textual", "serial"}
