"""The rooms: what each may know, and what start-up may import."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path

import pytest

from app.planning.hexaslide import Request, write_simulated
from protocols.machine_files import machine_names
from tests.conftest import ROOT, first_quick

ROOMS = ("app", "calib", "drivers", "protocols")


def imported(code: str) -> set[str]:
    """Top-level names of the modules that a fresh interpreter holds after this code."""
    script = f"{code}\nimport sys\nprint(*{{name.split('.')[0] for name in sys.modules}})"
    process = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=600
    )
    return set(process.stdout.split())


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


@pytest.mark.parametrize(
    "arguments",
    first_quick(
        [
            *(
                [verb, "no.jsonl"]
                for verb in ("solve", "diagnose", "validate", "plan", "align", "model")
            ),
            ["verify", "no.jsonl", "neither.jsonl"],
            ["compare", "no.jsonl", "neither.jsonl"],
            ["import", "no.csv", "-o", "new.jsonl"],
            ["export", "no.jsonl", "--format", "json", "-o", "new.json"],
            ["report", "no.jsonl", "-o", "new.html"],
            ["history", "no.jsonl"],
            ["run", "--continue", "no.jsonl"],
        ]
    ),
    ids=lambda arguments: arguments[0],
)
def test_a_file_that_is_not_there_is_named_before_anything_heavy_is_loaded(
    arguments: list[str],
) -> None:
    script = f"""
import sys
from app.cli import main
sys.argv = ["glidecal", *{arguments!r}]
try:
    main()
except SystemExit as end:
    print(end.code, *{{"numpy", "scipy", "textual"}} & {{*sys.modules}})
"""
    process = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=600
    )
    assert process.stdout.split() == ["3"]
    assert (
        f"file {arguments[-1] if arguments[0] == 'run' else arguments[1]}: No such"
        in process.stderr
    )


@pytest.mark.parametrize(
    ("other_machine", "arguments"),
    [
        ("hexaslide", ["solve", "sample_sessions/experiment_1_six.jsonl", "--json"]),
        ("hexaslide", ["identifiability", "linear-delta"]),
        ("tripod", ["solve", "--machine", "hexaslide", "measured.json", "--json"]),
        ("tripod", ["identifiability", "hexaslide", "--procedure", "pose-inverse"]),
    ],
)
def test_a_machine_loads_nothing_of_another(
    other_machine: str, arguments: list[str], tmp_path: Path
) -> None:
    measured = str(tmp_path / "measured.json")
    write_simulated(Request("pose-inverse", postures=10, seed=1), Path(measured), None)
    words = [measured if argument == "measured.json" else argument for argument in arguments]
    script = f"""
import atexit, sys
from app.cli import main
atexit.register(lambda: print(*sys.modules, file=sys.stderr))
sys.argv = ["glidecal", *{words!r}]
main()
"""
    process = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=600
    )
    loaded = process.stderr.splitlines()[-1].split()
    assert "calib.design.identifiability" in loaded
    assert not [name for name in loaded if name.startswith(f"calib.{other_machine}")]
    if "solve" in words:  # nobody asked for a model or a diagnosis; a tripod's bound weighs effects
        unasked = ("protocols.model_file", "calib.diagnosis.")
        # what is entered for six chains is weighed where they are diagnosed
        own_module = "calib.diagnosis.thresholds"
        strange = [name for name in loaded if name.startswith(unasked)]
        assert not [n for n in strange if other_machine == "hexaslide" or n != own_module]
        weighed = [name for name in loaded if name.startswith("calib.tripod.effects")]
        assert bool(weighed) is (other_machine == "hexaslide")


def test_a_machine_is_named_in_its_own_files_and_the_registry_alone() -> None:
    paths = [path for room in ROOMS for path in (ROOT / room).rglob("*.py")]
    naming = [path for path in paths if re.search("hexa.?slide", path.read_text("utf-8"), re.I)]
    other_paths = [path for path in naming if "hexaslide" not in str(path.relative_to(ROOT))]
    assert other_paths == [ROOT / "app/machines/registry.py"]


def test_no_command_knows_the_name_of_a_machine() -> None:
    names = {*machine_names(), "hexaslide"}
    for path in (*(ROOT / "app/commands").glob("*.py"), ROOT / "app/machines/registry.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        words = {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)}
        assert not words & names, path


def test_every_top_level_package_is_in_the_contract() -> None:
    """The layers are exhaustive: a new room must be placed in pyproject.toml."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    linter = settings["tool"]["importlinter"]
    layers = {
        name.strip() for layer in linter["contracts"][0]["layers"] for name in layer.split("|")
    }
    around = {"tests", "benchmarks", "studies"}
    packages = {p.parent.name for p in ROOT.glob("*/__init__.py")} - around
    assert packages == layers == set(linter["root_packages"]) == {*ROOMS, "glidecal"}


def test_every_screen_that_is_opened_by_its_name_is_there() -> None:
    """`screen_of` loads them by name, which no type checker sees."""
    opened = re.compile(r'screen_of[(,]\s*"(\w+)\.(\w+)"')
    code = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "app").rglob("*.py"))
    names = set(opened.findall(code))
    assert ("home", "HomeScreen") in names
    for module, kind in names:
        assert callable(getattr(import_module(f"app.screens.{module}"), kind))


def test_help_imports_nothing_heavy() -> None:
    heavy = {"numpy", "scipy", "pydantic", "textual", "serial"}
    assert imported("import app.cli") & heavy == set()


def test_solve_does_not_load_scipy_stats_or_textual() -> None:
    code = "import app.evaluating.solution, app.report.text.result, sys\n"
    code += "assert 'scipy.stats' not in sys.modules"
    assert not imported(code) & {"textual", "serial"}
