"""Settings on the screens: keys, theme, animations, palette, and leaving."""

from __future__ import annotations

from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.widgets import OptionList, Static
from textual.widgets._footer import FooterKey

from app.screens.check import CheckScreen
from app.screens.home import HomeScreen
from app.screens.interface import ChoiceDialog, Glidecal, HelpDialog, TextDialog
from app.settings import Settings, read_settings
from protocols.record import read_record
from tests.screens.driving import SIZE, quick_plan, said, take, to_measuring, until


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The settings file of this test; the current folder is empty and looks like markup."""
    path = tmp_path / "settings.toml"
    here = tmp_path / "here [mm]"
    here.mkdir()
    monkeypatch.setenv("GLIDECAL_SETTINGS", str(path))
    monkeypatch.chdir(here)
    return path


async def from_palette(pilot: Pilot[str], interface: Glidecal, command: str) -> None:
    await pilot.press("ctrl+p")
    await pick(pilot, interface, command)


async def pick(pilot: Pilot[str], interface: Glidecal, words: str) -> None:
    """Take the row of an open list that begins with these words."""
    await until(pilot, "list", lambda: isinstance(interface.screen, ChoiceDialog))
    dialog = interface.screen
    await until(pilot, "its rows", lambda: bool(dialog.query(OptionList)) and dialog.is_mounted)
    listed = dialog.query_one(OptionList)
    rows = [str(option.prompt)[3:].lower() for option in listed.options]
    listed.highlighted = next(k for k, row in enumerate(rows) if row.startswith(words))
    await pilot.press("enter")
    await until(pilot, "list closed", lambda: interface.screen is not dialog)


async def test_own_keys_take_the_place_of_the_usual_ones(tmp_path: Path) -> None:
    settings = Settings(keys={"measure.take": "f2,x", "measure.repeat": "s", "measure.skip": "u"})
    interface = Glidecal(CheckScreen(quick_plan(tmp_path)), settings=settings)
    async with interface.run_test(size=SIZE) as pilot:
        screen = await to_measuring(pilot, interface)
        assert "space" not in screen.active_bindings
        await until(pilot, "stillness", screen.attended.ready_by_hand)
        await pilot.press("f2")
        await until(pilot, "one step", lambda: screen.guided.session.done() == {1})
        await pilot.press("s")
        await until(pilot, "repeated", lambda: screen.guided.session.done() == frozenset())
        await until(pilot, "stillness", screen.attended.ready_by_hand)
        await pilot.press("x")
        await until(pilot, "again", lambda: screen.guided.session.done() == {1})
        await pilot.press("f10")


async def test_the_footer_keeps_the_order_of_importance(tmp_path: Path) -> None:
    """A key of the settings stands where the usual one stands."""
    lines = []
    for keys in ({}, {"measure.take": "f6", "measure.note": "t", "app.help": "f3"}):
        interface = Glidecal(CheckScreen(quick_plan(tmp_path)), settings=Settings(keys=keys))
        async with interface.run_test(size=SIZE) as pilot:
            screen = await to_measuring(pilot, interface)
            await until(pilot, "keys", lambda screen=screen: bool(screen.query(FooterKey)))
            await pilot.pause()
            lines.append([key.description for key in screen.query(FooterKey)])
            await pilot.press("f10")
    assert lines[0] == lines[1]
    assert lines[0][0] == "Take"
    assert lines[0][-2:] == ["Leave", "Help"]


async def test_theme_from_the_settings_is_not_written_again(file: Path) -> None:
    interface = Glidecal(HomeScreen(), settings=Settings(theme="nord"))
    async with interface.run_test(size=SIZE) as pilot:
        await pilot.pause()
        assert interface.theme == "nord"
        await pilot.press("f10")
    assert not file.exists()


async def test_light_and_dark_are_kept(file: Path) -> None:
    file.write_text('# mine\n[keys]\n"app.help" = "f3"\n', encoding="utf-8")
    interface = Glidecal(HomeScreen(), settings=read_settings(file))
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await from_palette(pilot, interface, "theme")
        await pick(pilot, interface, "textual-light")
        await until(pilot, "light", lambda: interface.theme == "textual-light")
        assert read_settings(file).theme == "textual-light"
        assert "# mine" in file.read_text(encoding="utf-8")
        interface.theme = "textual-dark"
        await until(pilot, "dark", lambda: read_settings(file).theme == "textual-dark")
        assert read_settings(file).keys == {"app.help": "f3"}
        file.write_text("[broken", encoding="utf-8")
        interface.theme = "textual-light"
        await until(pilot, "told", lambda: "TOML text" in said(interface))
        assert file.read_text(encoding="utf-8") == "[broken"
        await pilot.press("f10")


async def test_a_theme_by_name(file: Path) -> None:
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE) as pilot:
        await from_palette(pilot, interface, "theme")
        await pick(pilot, interface, "gruvbox")
        await until(pilot, "gruvbox", lambda: interface.theme == "gruvbox")
        assert read_settings(file).theme == "gruvbox"
        await pilot.press("f10")


async def test_a_page_that_only_shows_writes_nothing(file: Path) -> None:
    interface = Glidecal(HomeScreen(), read_only=True)
    async with interface.run_test(size=SIZE) as pilot:
        await pilot.pause()
        interface.theme = "textual-light"
        await pilot.pause()
        assert interface.theme == "textual-light"
        await pilot.press("ctrl+p")
        await until(pilot, "list", lambda: bool(interface.screen.query(OptionList)))
        rows = [str(row.prompt)[3:] for row in interface.screen.query_one(OptionList).options]
        assert [row.partition(":")[0] for row in rows] == ["Theme", "Keys", "Quit"]
        await pilot.press("escape", "f10")
    assert not file.exists()


async def test_screenshot_into_the_current_folder(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await pilot.pause()
        await from_palette(pilot, interface, "screenshot")
        await until(pilot, "told", lambda: "Written:" in said(interface))
        (picture,) = Path().glob("*.svg")
        assert f"{Path.cwd() / picture}" in said(interface)
        svg = picture.read_text(encoding="utf-8")
        assert "Demonstration" in svg
        assert "cancels" not in svg

        def refuse(*_: object, **__: object) -> None:
            raise PermissionError(13, "Permission denied")

        with monkeypatch.context() as patched:
            patched.setattr("tempfile.mkstemp", refuse)
            await from_palette(pilot, interface, "screenshot")
            await until(pilot, "words", lambda: "Permission denied" in said(interface))
        assert len(list(Path().iterdir())) == 1
        await pilot.press("f10")


async def test_keys_of_the_present_screen(tmp_path: Path) -> None:
    settings = Settings(keys={"measure.take": "f2"})
    interface = Glidecal(CheckScreen(quick_plan(tmp_path)), settings=settings)
    async with interface.run_test(size=SIZE) as pilot:
        await to_measuring(pilot, interface)
        await from_palette(pilot, interface, "keys")
        await until(pilot, "keys", lambda: isinstance(interface.screen, HelpDialog))
        listed = str(interface.screen.query_one(Static).content)
        assert "f2          Take" in listed
        assert "u           Repeat" in listed
        await pilot.press("escape")
        await from_palette(pilot, interface, "quit")
        await until(pilot, "left", lambda: interface.guided is None)


@pytest.mark.parametrize("animations", [True, False])
async def test_animations(animations: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("textual.constants.TEXTUAL_ANIMATIONS", "full")
    interface = Glidecal(HomeScreen(), settings=Settings(animations=animations))
    assert (interface.animation_level == "none") is not animations


async def test_ctrl_q_under_a_dialog_pauses_the_session(tmp_path: Path) -> None:
    plan = quick_plan(tmp_path)
    interface = Glidecal(CheckScreen(plan))
    async with interface.run_test(size=SIZE) as pilot:
        await take(pilot, await to_measuring(pilot, interface))
        await pilot.press("n")
        await until(pilot, "dialog", lambda: isinstance(interface.screen, TextDialog))
        await pilot.press("ctrl+q")
        await until(pilot, "left", lambda: interface.guided is None)
    assert "Session paused after 1 of 30 steps" in str(interface.return_value)
    assert read_record(plan.path).end == "open"
    assert list(tmp_path.iterdir()) == [plan.path]
