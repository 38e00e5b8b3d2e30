"""What the program calls itself in a checkout, against what git says is checked out there."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from app import version as versions
from tests.app.cli import glidecal
from tests.conftest import LONG, ROOT

NAME = ("-c", "user.name=a", "-c", "user.email=a@b")


def git(folder: Path, *words: str) -> str:
    if not shutil.which("git"):
        pytest.skip("no git")
    process = subprocess.run(
        ["git", "-C", str(folder), *NAME, *words], capture_output=True, text=True, check=True
    )
    return process.stdout.strip()


@pytest.fixture
def version_of(monkeypatch: pytest.MonkeyPatch) -> Callable[[Path], str]:
    """The version of a program that stands in a folder."""

    def version(folder: Path) -> str:
        monkeypatch.setattr(versions, "HOME", folder)
        versions.version.cache_clear()
        return versions.version()

    return version


@pytest.fixture(autouse=True)
def _forgotten() -> None:
    versions.version.cache_clear()


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    folder = tmp_path / "checkout"
    folder.mkdir()
    git(folder, "init", "--quiet")
    git(folder, "commit", "--quiet", "--allow-empty", "-m", "first")
    return folder


def test_a_checkout_tells_the_commit_of_this_moment(
    checkout: Path, version_of: Callable[[Path], str]
) -> None:
    """On a branch, packed, detached, in a worktree and in a clone without history or tags."""

    def right(folder: Path) -> bool:
        commit = git(folder, "rev-parse", "HEAD")
        return version_of(folder) == f"{versions.NEXT_RELEASE}+g{commit[:9]}.checkout"

    assert right(checkout)
    git(checkout, "commit", "--quiet", "--allow-empty", "-m", "second")
    assert right(checkout)
    git(checkout, "pack-refs", "--all")
    assert right(checkout)
    beside = checkout.parent / "beside"
    git(checkout, "worktree", "add", "--quiet", "-b", "aside/branch", str(beside), "HEAD~1")
    assert right(beside)
    git(checkout, "pack-refs", "--all")
    assert right(beside)
    shallow = checkout.parent / "shallow"
    git(checkout.parent, "clone", "--quiet", "--depth", "1", checkout.as_uri(), str(shallow))
    assert right(shallow)
    git(checkout, "checkout", "--quiet", "--detach", "HEAD~1")
    assert right(checkout)


def test_a_checkout_that_git_cannot_read_either_tells_no_commit(
    tmp_path: Path, version_of: Callable[[Path], str]
) -> None:
    (tmp_path / "secret").write_text("a line of a stranger")
    for number, head in enumerate(("ref: refs/heads/none", "ref: ../../../secret", "?", "\udcff")):
        git_folder = tmp_path / f"{number}" / ".git"
        git_folder.mkdir(parents=True)
        (git_folder / "HEAD").write_bytes(f"{head}\n".encode(errors="surrogateescape"))
        assert version_of(git_folder.parent) == f"{versions.NEXT_RELEASE}+checkout"
    moved = tmp_path / "moved"
    moved.mkdir()
    (moved / ".git").write_text("gitdir: ../gone\n")
    assert version_of(moved) == f"{versions.NEXT_RELEASE}+checkout"


def test_outside_git_and_not_installed_it_is_unknown(
    tmp_path: Path, version_of: Callable[[Path], str]
) -> None:
    assert version_of(tmp_path) == f"{versions.NEXT_RELEASE}+unknown"


def test_the_next_release_is_told_once() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]
    assert settings["setuptools_scm"]["fallback_version"] == versions.NEXT_RELEASE
    changes = (ROOT / "CHANGELOG.md").read_text("utf-8")
    heading = re.search(r"^## (\S+), unreleased$", changes, re.MULTILINE)
    assert heading is not None
    assert f"{heading[1]}.dev0" == versions.NEXT_RELEASE


@LONG
def test_the_program_its_records_and_its_exports_tell_the_version(
    tmp_path: Path, samples: Path
) -> None:
    program = glidecal("--version").out.strip()
    assert program == versions.program()
    assert "+" in program, "a version without a commit, in a checkout"
    table = samples / "tables" / "experiment_2_six.csv"
    record = tmp_path / "a.jsonl"
    assert glidecal("import", table, "-o", record).status == 0
    assert f'"program":"{program}"' in record.read_text("utf-8")
    offsets = tmp_path / "offsets.json"
    assert glidecal("export", record, "--format", "json", "-o", offsets).status == 0
    assert json.loads(offsets.read_text("utf-8"))["made"].endswith(f", {program}")
    page = tmp_path / "report.html"
    assert glidecal("report", record, "-o", page).status == 0
    assert program in page.read_text("utf-8")
