"""The wheel in an environment of its own, alone and beside a package that owns ``app``."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import venv
import zipfile
from importlib.metadata import version
from pathlib import Path

import pytest

from tests.conftest import LONG, ROOT, SAMPLES

pytestmark = LONG

PATIENCE_S = 600.0
PIP = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
OFFLINE = ["--no-deps", "--no-index"]


def run(*words: str | Path, **variables: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*map(str, words)],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
        env={"PATH": "/usr/bin:/bin", **variables} if sys.platform != "win32" else None,
    )


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy, committed: what a build leaves in a folder gets into the next wheel."""
    if run(*PIP, "--version").returncode:
        pytest.skip("this environment has no pip")
    if int(version("setuptools").split(".")[0]) < 77:
        pytest.skip("setuptools is older than the project's build asks for")
    if not shutil.which("git"):
        pytest.skip("no git, which the version comes from")
    copy = tmp_path_factory.mktemp("source")
    for name in ("pyproject.toml", "README.md", "LICENSE", ".gitignore"):
        shutil.copy(ROOT / name, copy)
    for room in ("app", "calib", "drivers", "glidecal", "protocols"):
        shutil.copytree(ROOT / room, copy / room, ignore=shutil.ignore_patterns("__pycache__"))
    somebody = ("-c", "user.name=a", "-c", "user.email=a@b")
    for words in (["init"], ["add", "."], [*somebody, "commit", "-m", "A copy"]):
        process = run("git", "-C", copy, *words)
        assert process.returncode == 0, process.stderr
    return copy


def built(source: Path, target: Path) -> Path:
    """The wheel of a folder or an archive."""
    process = run(*PIP, "wheel", *OFFLINE, "--no-build-isolation", "-w", target, source)
    assert process.returncode == 0, process.stderr
    (wheel,) = target.glob("glidecal-*.whl")
    return wheel


@pytest.fixture(scope="module")
def wheel(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built(source, tmp_path_factory.mktemp("wheels"))


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A stranger's package with a folder ``app``, as many have."""
    path = tmp_path_factory.mktemp("foreign") / "shop-1.0-py3-none-any.whl"
    info = "shop-1.0.dist-info"
    written = {
        "app/__init__.py": "NAME = 'shop'\n",
        "app/orders.py": "",
        f"{info}/METADATA": "Metadata-Version: 2.1\nName: shop\nVersion: 1.0\n",
        f"{info}/WHEEL": "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    }
    record = "".join(f"{name},,\n" for name in (*written, f"{info}/RECORD"))
    with zipfile.ZipFile(path, "w") as packed:
        for name, text in {**written, f"{info}/RECORD": record}.items():
            packed.writestr(name, text)
    return path


class Environment:
    """An environment that has the libraries of this one, and what is installed here."""

    def __init__(self, folder: Path) -> None:
        venv.create(folder, with_pip=False, symlinks=sys.platform != "win32")
        scripts = folder / ("Scripts" if sys.platform == "win32" else "bin")
        self.python, self.glidecal = scripts / "python", scripts / "glidecal"
        (self.site,) = (path for path in folder.rglob("site-packages"))
        libraries = next(path for path in sys.path if path.endswith("site-packages"))
        (self.site / "libraries.pth").write_text(f"{libraries}\n", "utf-8")  # its own .pth unread

    def install(self, *wheels: Path) -> None:
        target = ["--python", str(self.python), "install", "--no-compile", *OFFLINE]
        for archive in wheels:
            process = run(*PIP, *target, archive)
            assert process.returncode == 0, process.stderr

    def refused(self, *words: str, **variables: str) -> str:
        process = run(*(words or (self.glidecal, "--version")), **variables)
        assert (process.returncode, process.stdout) == (2, ""), process.stderr
        (message,) = process.stderr.splitlines()
        assert message.startswith("glidecal: package 'app': ")
        assert "pipx install glidecal" in message
        return message


@pytest.fixture
def environment(tmp_path: Path) -> Environment:
    return Environment(tmp_path / "environment")


def test_the_wheel_alone_runs_and_a_stranger_over_it_is_told(
    environment: Environment, wheel: Path, foreign: Path, tmp_path: Path
) -> None:
    environment.install(wheel)
    process = run(environment.glidecal, "solve", SAMPLES / "experiment_2_six.jsonl", "--json")
    assert process.returncode == 0, process.stderr
    script = "import glidecal, app; print(glidecal.load.__module__, app.__file__)"
    assert str(environment.site) in run(environment.python, "-P", "-c", script).stdout
    with zipfile.ZipFile(foreign) as packed:
        packed.extractall(tmp_path / "other")
    earlier = environment.refused(PYTHONPATH=str(tmp_path / "other"))
    assert f"found in {tmp_path / 'other' / 'app'}" in earlier
    (environment.site / "app/__init__.py").write_text("NAME = 'shop'\n", "utf-8")
    assert "written over by another package" in environment.refused()
    environment.install(foreign)
    assert "contains orders.py of another package" in environment.refused()


def test_the_wheel_tells_the_commit_also_where_it_was_built_from_an_archive(
    environment: Environment, wheel: Path, source: Path, tmp_path: Path
) -> None:
    environment.install(wheel)
    version_line = run(environment.glidecal, "--version").stdout.strip()
    commit = run("git", "-C", source, "rev-parse", "HEAD").stdout[:7]
    assert re.fullmatch(rf"glidecal 0\.1\.0\.dev\d+\+g{commit}\w*", version_line)
    script = "from setuptools.build_meta import build_sdist; build_sdist('made')"
    process = run(sys.executable, "-c", f"import os; os.chdir({str(source)!r}); {script}")
    assert process.returncode == 0, process.stderr
    (archive,) = (source / "made").glob("glidecal-*.tar.gz")
    assert built(archive, tmp_path).name == wheel.name


def test_installed_over_a_package_that_owns_app_it_refuses_to_start(
    environment: Environment, wheel: Path, foreign: Path
) -> None:
    environment.install(foreign, wheel)
    assert "contains orders.py of another package" in environment.refused()
    process = run(environment.python, "-P", "-c", "import glidecal; glidecal.load")
    assert process.stderr.splitlines()[-1].startswith("ImportError: package 'app': ")


def test_the_wheel_holds_every_file_of_data(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    kinds = ("html", "tcss", "toml", "comp", "typed")
    rooms = [ROOT / room for room in ("app", "calib", "drivers", "glidecal", "protocols")]
    data = {p.relative_to(ROOT).as_posix() for r in rooms for k in kinds for p in r.rglob(f"*.{k}")}
    assert len(data) > 10
    assert data <= names
