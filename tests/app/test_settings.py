"""The settings file: read, refused with its line, and changed without losing the rest."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from app.settings import Settings, read_settings, save_theme, settings_path, with_theme
from calib.errors import RecordError, UsageError
from tests.app.cli import glidecal, refused
from tests.conftest import needs_links

OWN = """\
# mine
animations = false

[keys]
"measure.take" = "space,f2"   # the foot switch
measure.hold = "h"
"""


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "settings [mm].toml"
    monkeypatch.setenv("GLIDECAL_SETTINGS", str(path))
    return path


def write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


def test_without_a_file_everything_has_its_default(file: Path) -> None:
    assert settings_path() == file
    assert read_settings(file) == Settings(theme=None, animations=True, keys={})


@needs_links
def test_no_theme_is_written_through_a_link(file: Path, tmp_path: Path) -> None:
    write(tmp_path / "real.toml", OWN)
    file.symlink_to(tmp_path / "real.toml")
    assert read_settings(file).animations is False
    with pytest.raises(UsageError, match="a link to"):
        save_theme(file, "nord")
    assert (tmp_path / "real.toml").read_text(encoding="utf-8") == OWN
    file.unlink()
    file.symlink_to(tmp_path / "nowhere.toml")
    with pytest.raises(UsageError, match="a link to"):
        save_theme(file, "nord")
    assert not (tmp_path / "nowhere.toml").exists()


def test_without_the_variable_it_is_in_the_users_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("GLIDECAL_SETTINGS", raising=False)
    assert settings_path().name == "settings.toml"
    assert "glidecal" in settings_path().parts


def test_keys_may_be_written_with_and_without_quotes(file: Path) -> None:
    write(file, OWN)
    settings = read_settings(file)
    assert settings.animations is False
    assert settings.keys == {"measure.take": "space,f2", "measure.hold": "h"}


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ('theme = "pink [mm]"\n', 1, "textual-light"),
        ('\n[keys]\n"measure.talk" = "f2"\n', 3, "an unknown id"),
        ('[keys]\n\n"measure.take" = "spacebar"\n', 3, "found key 'spacebar'"),
        ('[keys]\n"measure.take" = "space,"\n', 2, "found key ''"),
        ('[keys]\n"measure.take" = "u"\n', 2, "'u', which is measure.repeat too"),
        ('[keys]\n"app.help" = "space"\n', 2, "'space', which is"),
        ('[keys]\n"measure.take" = "ctrl+c"\n', 2, "'ctrl+c', which is"),
        ('animations = "no"\n', 1, "true or false"),
        ("[keys]\nmeasure.take = 5\n", 2, "must be a text"),
        ("colour = 5\n", 1, "no such key"),
    ],
)
def test_what_does_not_fit_is_told_with_its_line(
    file: Path, text: str, line: int, message: str
) -> None:
    write(file, text)
    words = refused(3, "settings")
    assert str(file) in words
    assert f"line {line}," in words
    assert message in words


def test_swapped_keys_do_not_clash(file: Path) -> None:
    write(file, '[keys]\n"measure.repeat" = "s"\n"measure.skip" = "u"\n"result.export" = "e"\n')
    assert glidecal("settings").status == 0


def test_the_command_lists_file_values_and_every_key(file: Path) -> None:
    run = glidecal("settings")
    assert f"{file} (not there yet" in run.out.replace("\n", " ")
    write(file, OWN)
    run = glidecal("settings")
    assert "not there yet" not in run.out
    assert "animations  off" in run.out
    (row,) = (line for line in run.out.splitlines() if line.strip().startswith("measure.take "))
    assert row.split() == ["measure.take", "space", "space,f2", "Take"]
    for key_id in ("app.quit", "check.begin", "prepare.dry-run", "page.copy", "replay.play"):
        assert key_id in run.out
    assert "…" not in run.out, "an id is copied"
    rows = [re.split(r" {2,}", line.strip()) for line in run.out.splitlines()]
    (does,) = (row[-1] for row in rows if row[0] == "what_if.much_larger")
    assert does == "Much larger"
    (keys,) = (row for row in rows if row[0] == "hexaslide.next_posture")
    assert keys == ["hexaslide.next_posture", "plus", "Next posture"]


def test_a_theme_is_added_and_replaced_and_the_rest_stays(file: Path) -> None:
    write(file, OWN)
    save_theme(file, "nord")
    text = file.read_text(encoding="utf-8")
    assert text == 'theme = "nord"\n' + OWN
    save_theme(file, "textual-light")
    assert file.read_text(encoding="utf-8") == 'theme = "textual-light"\n' + OWN
    assert read_settings(file).keys == {"measure.take": "space,f2", "measure.hold": "h"}
    assert list(file.parent.iterdir()) == [file]
    fresh = file.with_name("folder") / "new.toml"
    save_theme(fresh, "nord")
    assert read_settings(fresh).theme == "nord"


def test_a_theme_below_other_keys_keeps_its_comment() -> None:
    text = 'animations = true\ntheme = \'nord\' # dark\n[keys]\n"app.help" = "f3"\n'
    changed = with_theme(text, "dracula")
    assert changed == text.replace("'nord'", '"dracula"')
    assert tomllib.loads(changed)["theme"] == "dracula"


def test_a_broken_file_is_never_replaced(file: Path) -> None:
    write(file, "theme = \n[keys\n")
    with pytest.raises(RecordError, match="TOML text"):
        save_theme(file, "nord")
    assert file.read_text(encoding="utf-8") == "theme = \n[keys\n"
    write(file, 'theme = """\nnord"""\n')
    with pytest.raises(RecordError, match="by hand"):
        save_theme(file, "dracula")
    assert "nord" in file.read_text(encoding="utf-8")


def test_a_folder_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.touch()
    with pytest.raises(RecordError, match="a place with write permission"):
        save_theme(blocked / "settings.toml", "nord")
