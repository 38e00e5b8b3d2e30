"""Choosing indicators before a session: ports, profiles, what was used last, what was typed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from textual.pilot import Pilot
from textual.widgets import Input, OptionList, Select

from app.measuring.indicators import (
    RememberedIndicators,
    last_used,
    port_is_gone,
    remember,
)
from app.measuring.opening import open_indicators, start_session
from app.screens.check import CheckScreen
from app.screens.home import HomeScreen
from app.screens.interface import Glidecal
from app.screens.measure import MeasureScreen
from app.screens.prepare import IndicatorScreen, PrepareScreen
from app.settings import data_path
from calib.errors import RecordError
from drivers.profile import Spindle
from drivers.profiles import PROFILES
from drivers.twins import IndicatorTwin, LineTrouble, TwinPort, default_transport
from protocols.machine import Instrument
from protocols.record import read_record
from tests.conftest import LONG, needs_links
from tests.screens.driving import SIZE, fill_in, quick_plan, said, text, until

SYLVAC = Instrument(profile="sylvac", port="/dev/ttyNONE7", axes="yx", serial_number="4711")


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))


@pytest.fixture
def quick_profiles(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trying does not take its half a minute."""
    quick = {k: replace(p, timeout_s=0.15, interval_s=0.0) for k, p in PROFILES.items()}
    monkeypatch.setattr("app.measuring.preparation.PROFILES", quick)


@pytest.fixture
def twin() -> Iterator[TwinPort]:
    device = IndicatorTwin(PROFILES["tesa"], Spindle(lambda: 0.5, 0.001))
    with TwinPort(device, default_transport()) as port:
        yield port


async def form(pilot: Pilot[str], interface: Glidecal) -> PrepareScreen:
    await pilot.press("enter")
    await until(pilot, "form", lambda: isinstance(interface.screen, PrepareScreen))
    await pilot.pause()
    assert isinstance(interface.screen, PrepareScreen)
    return interface.screen


async def opened(pilot: Pilot[str], interface: Glidecal) -> IndicatorScreen:
    await pilot.press("enter")
    await until(pilot, "its form", lambda: isinstance(interface.screen, IndicatorScreen))
    await pilot.pause()
    assert isinstance(interface.screen, IndicatorScreen)
    return interface.screen


async def test_profiles_are_tried_where_asked_and_those_that_fit_stand_first(
    quick_profiles: None, twin: TwinPort
) -> None:
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await form(pilot, interface)
        screen = await opened(pilot, interface)
        screen.query_one("#port", Input).focus()
        await pilot.press(*twin.url)
        assert "F3 tries which profiles fit" in text(interface, "#summary")
        await pilot.press("f3")
        await until(pilot, "findings", lambda: "tesa fits" in text(interface, "#summary"))
        await pilot.pause()
        profile = screen.query_one("#profile", Select)
        assert profile.value == "sylvac"  # the first that somebody verified
        words = [str(option.prompt) for option in profile.query_one(OptionList).options]
        assert [w.split()[1] for w in words if w.startswith("fits:")] == [
            "mahr-marcator",
            "sylvac",
            "sylvac-simplex",
            "tesa",
        ]
        assert "give the same answers" in " ".join(text(interface, "#summary").split())
        profile.value = "tesa"
        await pilot.pause()
        await pilot.press("escape")
        await until(pilot, "back", lambda: isinstance(interface.screen, PrepareScreen))
        assert text(interface, "#indicator1") == f"tesa at {twin.url}, any direction"
        await pilot.press("f10")


async def test_trying_can_be_stopped_and_nothing_is_written_unasked(
    quick_profiles: None,
) -> None:
    heard: list[bytes] = []

    class Silent:
        def receive(self, request: bytes) -> bytes:
            heard.append(request)
            return b""

    interface = Glidecal(HomeScreen())
    with TwinPort(Silent(), default_transport()) as port:
        async with interface.run_test(size=SIZE, notifications=True) as pilot:
            await form(pilot, interface)
            screen = await opened(pilot, interface)
            screen.query_one("#port", Input).value = port.url
            await pilot.pause(0.3)
            assert heard == []
            await pilot.press("f3")
            await until(pilot, "a request", lambda: bool(heard))
            assert "Escape stops" in text(interface, "#summary")
            await pilot.press("escape")
            await until(pilot, "an end", lambda: "Stopped before" in text(interface, "#summary"))
            assert interface.screen is screen
            await pilot.press("escape")
            await until(pilot, "back", lambda: isinstance(interface.screen, PrepareScreen))
            await pilot.press("f10")


async def test_a_port_that_cannot_be_tried_says_why(quick_profiles: None) -> None:
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await form(pilot, interface)
        screen = await opened(pilot, interface)
        await pilot.press("f3")
        await until(pilot, "no port", lambda: "port: found none" in said(interface))
        for port, why in (("/dev/ttyNONE7", "no such port"), ("socket://127.0.0.1:1", "no device")):
            screen.query_one("#port", Input).value = port
            await pilot.press("f3")
            await until(pilot, why, lambda why=why: why in text(interface, "#summary"))
        with TwinPort(
            IndicatorTwin(PROFILES["sylvac"], Spindle(lambda: 0.5, 0.001), LineTrouble.DISCONNECT),
            "tcp",
        ) as twin:
            screen.query_one("#port", Input).value = twin.url
            await pilot.press("f3")
            await until(pilot, "gone", lambda: twin.url in text(interface, "#summary"))
        assert interface.screen is screen
        await pilot.press("f10")


@LONG
async def test_what_was_typed_stays_and_is_judged_once_it_is_typed(twin: TwinPort) -> None:
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await form(pilot, interface)
        await fill_in(
            pilot,
            interface,
            "indicator2",
            port=twin.url,
            profile="tesa",
            axes="zy",
            serial_number="4711 [x]",
            certificate_date="2026-13-40",
        )
        assert "certificate date: found '2026-13-40'" in text(interface, "#summary")
        await pilot.press("f5")
        await pilot.pause()
        assert interface.screen is screen
        await fill_in(pilot, interface, "indicator2", certificate_date="2026-01-31")
        screen.query_one("#serial", Input).value = "OG-7"
        screen.query_one("#place", Input).value = "hall [3]"
        screen.query_one("#operator", Input).value = "Ada"
        screen.query_one("#temperature", Input).value = "21,5"
        screen.query_one("#note", Input).value = "after the crash"
        await pilot.pause()
        assert "60 steps with 1 indicator" not in text(interface, "#summary")  # z, y: not leg x
        await fill_in(pilot, interface, "indicator2", axes="xyz")
        assert "60 steps with 1 indicator" in text(interface, "#summary")
        await pilot.press("escape")
        await until(pilot, "home", lambda: isinstance(interface.screen, HomeScreen))
        await form(pilot, interface)
        assert interface.screen.query_one("#operator", Input).value == "Ada"
        assert "no. 4711 [x]" in text(interface, "#indicator2")
        await pilot.press("f5")
        await until(pilot, "check", lambda: isinstance(interface.screen, CheckScreen))
        await until(pilot, "open", lambda: interface.indicators is not None)
        await pilot.press("enter")
        await until(pilot, "measuring", lambda: isinstance(interface.screen, MeasureScreen))
        await pilot.press("f10")
    (path,) = Path().glob("*.jsonl")
    record = read_record(path)
    (instrument,) = record.opened.instruments
    assert (instrument.serial_number, str(instrument.certificate_date)) == (
        "4711 [x]",
        "2026-01-31",
    )
    assert (record.opened.operator, record.opened.temperature_c) == ("Ada", 21.5)
    machine = record.opened.machine
    assert (machine.serial_number, machine.place) == ("OG-7", "hall [3]")
    assert last_used().serial_numbers["orthoglide"] == "OG-7"
    assert last_used().places["orthoglide"] == "hall [3]"
    assert "after the crash" in path.read_text(encoding="utf-8")
    assert last_used().machines["orthoglide"] == (instrument,)


async def test_the_indicators_used_last_are_proposed_and_a_missing_port_is_said() -> None:
    remember("orthoglide", [SYLVAC])
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await form(pilot, interface)
        line = "sylvac at /dev/ttyNONE7 (not plugged in), y, else x, no. 4711, as last time"
        assert text(interface, "#indicator1") == line
        screen.query_one("#machine", Input).value = "linear-delta"
        await pilot.pause()
        assert "none yet" in text(interface, "#indicator1")
        screen.query_one("#machine", Input).value = ""
        await pilot.pause()
        assert text(interface, "#indicator1") == line
        screen.query_one("#indicator1").focus()
        await opened(pilot, interface)
        await pilot.press("escape")
        await until(pilot, "back", lambda: interface.screen is screen)
        assert text(interface, "#indicator1") == line
        await pilot.press("delete")
        await pilot.pause()
        assert "none yet" in text(interface, "#indicator1")
        await pilot.press("f5")
        await until(pilot, "words", lambda: "indicators: found none" in said(interface))
        await pilot.press("f10")


async def test_which_machine_it_is_and_where_is_asked_once(tmp_path: Path) -> None:
    identity = ("serial", "place")
    remember("orthoglide", [SYLVAC], "OG-7", "hall 3")
    other_file = tmp_path / "other.toml"
    other_file.write_text(
        'schema = "glidecal.machine/1"\nserial_number = "OG-9"\nplace = "room 5"\n',
        encoding="utf-8",
    )
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await form(pilot, interface)
        assert [screen.query_one(f"#{n}", Input).value for n in identity] == ["OG-7", "hall 3"]
        screen.query_one("#machine", Input).value = str(other_file)
        await pilot.pause()
        assert [screen.query_one(f"#{n}", Input).value for n in identity] == ["OG-9", "room 5"]
        await pilot.press("f10")


async def test_a_damaged_memory_is_told_and_the_form_goes_on() -> None:
    remember("orthoglide", [SYLVAC])
    data_path().write_text('{"machines": {"orthoglide": [1]}}', encoding="utf-8")
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await form(pilot, interface)
        assert "Remove the file" in said(interface)
        assert "Choose an indicator" in text(interface, "#summary")
        await pilot.press("f10")
    with pytest.raises(RecordError, match="Remove the file"):
        last_used()


def test_a_session_that_was_begun_is_remembered_and_a_damaged_memory_does_no_harm(
    tmp_path: Path, twin: TwinPort
) -> None:
    instrument = Instrument(profile="tesa", port=twin.url)
    plan = replace(quick_plan(tmp_path), instruments=(instrument,))
    data_path().parent.mkdir(parents=True)
    data_path().write_text("{", encoding="utf-8")
    start_session(plan).leave()
    assert data_path().read_text(encoding="utf-8") == "{"
    data_path().unlink()
    start_session(replace(plan, path=tmp_path / "other.jsonl")).leave()
    assert last_used().machines == {plan.machine.name: (instrument,)}
    remember("another", [SYLVAC])
    stored = RememberedIndicators.model_validate_json(data_path().read_text(encoding="utf-8"))
    assert stored.machines == {plan.machine.name: (instrument,), "another": (SYLVAC,)}


@needs_links
def test_a_memory_that_is_a_link_is_not_written_and_ends_no_session(
    tmp_path: Path, twin: TwinPort
) -> None:
    plan = replace(quick_plan(tmp_path), instruments=(Instrument(profile="tesa", port=twin.url),))
    data_path().parent.mkdir(parents=True)
    data_path().symlink_to(tmp_path / "nowhere")
    start_session(plan).leave()
    assert plan.path.exists()
    assert not (tmp_path / "nowhere").exists()


def test_simulated_indicators_are_nothing_to_remember(tmp_path: Path) -> None:
    plan = quick_plan(tmp_path)
    open_indicators(plan).close()
    start_session(plan).leave()
    assert not data_path().exists()


def test_a_port_is_gone_where_the_system_has_none(twin: TwinPort) -> None:
    assert not port_is_gone(twin.url)
    assert port_is_gone("/dev/ttyNONE7")
    assert not port_is_gone("socket://127.0.0.1:1")


async def test_a_linear_delta_is_offered_plates_and_begins_with_one_indicator(
    twin: TwinPort,
) -> None:
    interface = Glidecal(HomeScreen())
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        screen = await form(pilot, interface)
        procedure = screen.query_one("#procedure", Select)
        assert procedure.value == "zero-max-min"
        procedure.value = "sweep"
        screen.query_one("#machine", Input).value = "linear-delta"
        await until(pilot, "plates", lambda: procedure.value == "plate-rings")
        await until(pilot, "words", lambda: "58 steps with 1" in text(interface, "#summary"))
        assert text(interface, "#indicator2") == "none: one reads the tool. Enter chooses"
        fits_no_leg = {"profile": "tesa", "port": twin.url, "axes": "z"}
        await fill_in(pilot, interface, "indicator1", **fits_no_leg)
        await pilot.press("f5")
        await until(pilot, "check", lambda: isinstance(interface.screen, CheckScreen))
        await until(pilot, "indicators open", lambda: interface.indicators is not None)
        await until(pilot, "words", lambda: "along Z at the tool" in text(interface, "#trial"))
        await pilot.press("escape")
        await until(pilot, "back", lambda: isinstance(interface.screen, PrepareScreen))
        screen.query_one("#machine", Input).value = ""
        await until(pilot, "legs", lambda: procedure.value == "zero-max-min")
        assert "@z do not fit leg z" in text(interface, "#summary")
        await pilot.press("f10")
