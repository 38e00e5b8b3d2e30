"""What README promises of the first minute."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import pytest

from calib.errors import UsageError, extra, install_command
from tests.app.cli import glidecal
from tests.conftest import LONG, ROOT


@LONG
def test_the_tolerance_of_readme_is_kept_by_the_demonstration(tmp_path: Path) -> None:
    words = re.search(
        r"glidecal verify \S+ \S+ --tolerance (\S+)", (ROOT / "README.md").read_text()
    )
    assert words
    folder = tmp_path / "demo-sessions"
    assert glidecal("demo", "--headless", "--folder", folder).status == 0
    (before,) = folder.glob("*_demo.jsonl")
    (after,) = folder.glob("*_demo_verify.jsonl")
    run = glidecal("verify", before, after, "--tolerance", words[1])
    assert run.status == 0, run.out
    assert "PASS" in run.out


def test_the_demonstration_is_installed_with_what_its_report_needs() -> None:
    makefile = (ROOT / "Makefile").read_text()
    recipe = makefile.partition("$(VENV)/runtime.stamp: ")[2].partition("\n\n")[0]
    assert "-e '.[report]'" in recipe


def test_a_missing_package_is_installed_by_the_command_that_is_said() -> None:
    """It names this Python and each package of the extra, as in a clone so from a wheel."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    for name in ("report", "xlsx", "parquet", "frames", "serve", "cluster"):
        packages = " ".join(
            f'"{requirement}"' for requirement in project["optional-dependencies"][name]
        )
        assert install_command(name) == f"{sys.executable} -m pip install {packages}"
    with pytest.raises(UsageError, match=r"-m pip install \"openpyxl>="), extra("a table", "xlsx"):
        raise ImportError(name="openpyxl")
    dry = [*install_command("xlsx").replace('"', "").split(), "--dry-run", "--quiet", "--no-index"]
    assert subprocess.run(dry, check=False, timeout=600).returncode == 0, "installed here: no index"


def test_a_program_that_was_never_installed_says_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(_: str) -> list[str]:
        raise metadata.PackageNotFoundError

    monkeypatch.setattr(metadata, "requires", missing)
    assert install_command("xlsx").endswith('-m pip install "glidecal[xlsx]"')
