"""``make ends``: do the bounds in pyproject.toml hold, and does what came out since still fit?

The wheel is built once and installed into two empty environments, with all that a user may ask for:
the lowest version of each dependency on the oldest Python of this machine that glidecal allows, and
the newest of all on the newest Python. In each a whole calibration is run by the commands and some
tests of calculation, files and screens run on what was installed. Exit status 1 where one fails.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
PATIENCE_S = 600.0
LEAST_PYTHON = (3, 11)
EXTRAS = ("cluster", "frames", "parquet", "report", "serve", "sign", "xlsx")
"""What users install; the other two are of developers."""

BOUND = re.compile(r"([\w.-]+(?:\[[\w,]+\])?)>=([\w.]+)")
RUNNERS = ("pytest", "pytest-timeout", "pytest-asyncio", "hypothesis")
TESTS = (
    *("tests/calib/tripod/test_effects.py", "tests/calib/tripod/test_controller.py"),
    *("tests/app/commands/test_tables.py", "tests/screens/test_plot.py"),
)


def lowest() -> list[str]:
    """What pip is told for the lowest end: each dependency at the bound that pyproject.toml states.

    Raises ValueError for one without a lower bound.
    """
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    extras = project["optional-dependencies"]
    pins = []
    for dependency in [
        *project["dependencies"],
        *(requirement for name in EXTRAS for requirement in extras[name]),
    ]:
        bound = BOUND.fullmatch(dependency)
        if bound is None:
            raise ValueError(f"{dependency}: no lower bound alone, such as numpy>=1.26")
        pins.append(f"{bound[1]}=={bound[2]}")
    return pins


def pythons() -> dict[tuple[int, ...], str]:
    """Each Python of this machine that glidecal allows and that can make environments."""
    versions_folder = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    on_path = (shutil.which(f"python3.{minor}") for minor in range(LEAST_PYTHON[1], 30))
    candidates = (*on_path, *versions_folder.glob("*/bin/python3"), sys.executable)
    script = "import ensurepip, sys, venv; print(*sys.version_info[:2])"
    interpreters = {}
    for candidate in (str(path) for path in candidates if path):
        process = subprocess.run(
            [candidate, "-c", script], capture_output=True, text=True, check=False
        )
        version = tuple(map(int, process.stdout.split())) if process.returncode == 0 else ()
        if version >= LEAST_PYTHON:
            interpreters[version] = candidate
    return interpreters


def run(*words: str | Path, cwd: Path, may_warn: bool = False) -> str:
    """Its output. Ends the program, with what was printed, where it fails or warns."""
    command = [str(word) for word in words]
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    process = subprocess.run(
        command,
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    if process.returncode or ("Warning: " in process.stderr and not may_warn):
        print(process.stdout[-5000:], process.stderr[-5000:], sep="\n")
        sys.exit(f"ends: exit status {process.returncode}: {' '.join(command)}")
    return process.stdout


def build(folder: Path) -> Path:
    """The wheel of the files as they are, with git beside them for the version."""
    source = folder / "source"
    run("git", "clone", "--quiet", ROOT, source, cwd=folder)
    for name in run("git", "ls-files", "-z", cwd=ROOT).split("\0"):
        if (ROOT / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, source / name)
    # setuptools-scm warns of a clone without history
    run(*PIP, "wheel", "--no-deps", "-w", folder, source, cwd=folder, may_warn=True)
    (wheel,) = folder.glob("glidecal-*.whl")
    return wheel


PIP = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet")


def install(python: str, wheel: Path, pins: list[str], folder: Path) -> Path:
    """The folder of programs of a new environment."""
    run(python, "-m", "venv", folder / "environment", cwd=folder)
    programs = folder / "environment" / ("Scripts" if sys.platform == "win32" else "bin")
    pip = (programs / "python", *PIP[1:-1])  # not quiet: it says what does not go together
    run(*pip, "install", f"{wheel}[{','.join(EXTRAS)}]", *pins, *RUNNERS, cwd=folder)
    run(*pip, "check", cwd=folder)
    return programs


def calibrate(glidecal: Path, wheel: Path, folder: Path) -> None:
    """What README shows, in an empty folder."""
    version = run(glidecal, "--version", cwd=folder).split()[1]
    if f"glidecal-{version}-" not in wheel.name:
        sys.exit(f"ends: the version is {version}, the wheel {wheel.name}")
    run(glidecal, "demo", "--headless", cwd=folder)
    after, before = sorted(folder.glob("demo-sessions/*.jsonl"), key=lambda path: path.stem)[::-1]
    run(glidecal, "validate", before, after, cwd=folder)
    run(glidecal, "solve", before, cwd=folder)
    run(glidecal, "diagnose", before, "--json", cwd=folder)
    run(glidecal, "export", before, "--format", "linuxcnc", "-o", "entries", cwd=folder)
    for kind in ("csv", "xlsx", "parquet"):
        table = ("--table", "readings", "--format", kind, "-o", f"t.{kind}")
        run(glidecal, "export", before, *table, cwd=folder)
        run(glidecal, "import", f"t.{kind}", "-o", f"{kind}.jsonl", cwd=folder)
    run(glidecal, "report", before, "--after", after, "-o", "report.html", cwd=folder)
    # without a tolerance nothing is judged; this one is wide: measurements differ
    run(glidecal, "verify", before, after, "--tolerance", "0.2", cwd=folder)


def tests(python: Path, folder: Path) -> None:
    """On the installed program: its folders are not beside them."""
    for part in ("tests", "sample_sessions"):
        shutil.copytree(ROOT / part, folder / part)
    shutil.copy(ROOT / "pyproject.toml", folder)
    # what other packages announce of one another is not ours
    quiet = ("-W", "ignore::DeprecationWarning", "-p", "no:cacheprovider", "-q")
    print(run(python, "-m", "pytest", *quiet, *TESTS, cwd=folder).splitlines()[-1])


def main() -> None:
    """Try both."""
    interpreters = pythons()
    newest: list[str] = []
    ends = (("lowest", min(interpreters), lowest()), ("newest", max(interpreters), newest))
    with tempfile.TemporaryDirectory(prefix="glidecal-ends-") as name:
        wheel = build(Path(name))
        for end, version, pins in ends:
            begin = time.monotonic()
            folder = Path(name, end)
            (folder / "empty").mkdir(parents=True)
            programs = install(interpreters[version], wheel, pins, folder)
            calibrate(programs / "glidecal", wheel, folder / "empty")
            tests(programs / "python", folder)
            python = ".".join(map(str, version))
            took_s = time.monotonic() - begin
            print(f"{end} versions, Python {python}: {wheel.name} runs ({took_s:.0f} s)")


if __name__ == "__main__":
    main()
