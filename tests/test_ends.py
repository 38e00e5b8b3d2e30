"""What ``make ends`` installs, for it is not run with every test."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests import ends
from tests.conftest import LONG


def test_every_dependency_of_a_user_is_tried_at_its_bound() -> None:
    pins = ends.lowest()
    assert "numpy==1.26" in pins
    assert "dask[distributed]==2024.8" in pins
    names = {pin.split("==")[0] for pin in pins}
    assert {"textual", "pandas", "openpyxl", "weasyprint", "textual-serve"} <= names
    assert not {"ruff", "lmfit"} & names


@pytest.mark.parametrize("wrong", ["numpy", "numpy>=1.26,<3", "numpy~=1.26"])
def test_a_dependency_needs_a_lower_bound(
    wrong: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    extras = "".join(f"{name} = []\n" for name in ends.EXTRAS)
    (tmp_path / "pyproject.toml").write_text(
        f'[project]\ndependencies = ["{wrong}"]\n[project.optional-dependencies]\n{extras}'
    )
    monkeypatch.setattr(ends, "ROOT", tmp_path)
    with pytest.raises(ValueError, match="no lower bound alone"):
        ends.lowest()


@LONG
def test_this_python_is_among_those_of_the_machine() -> None:
    assert sys.version_info[:2] in ends.pythons()
    assert min(ends.pythons()) >= ends.LEAST_PYTHON


def test_what_fails_or_warns_ends_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    warned = "import warnings; warnings.warn('numpy changes', FutureWarning)"
    for script in ("raise SystemExit(3)", warned):
        with pytest.raises(SystemExit, match="ends: exit status"):
            ends.run(sys.executable, "-c", script, cwd=tmp_path)
    assert "numpy changes" in capsys.readouterr().out
    assert ends.run(sys.executable, "-c", "print(1)", cwd=tmp_path) == "1\n"
