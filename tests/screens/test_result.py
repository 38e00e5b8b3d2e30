"""The result screen: pages, plot, export, verification, comparison, refusals."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from textual.containers import VerticalScroll
from textual.geometry import Size
from textual.screen import Screen
from textual.widgets import Footer, Static, TabbedContent
from textual.widgets._footer import FooterKey
from textual.widgets._toast import Toast

from app.evaluating.solution import SessionSolution, solve_files
from app.measuring.demo import demo_plan
from app.measuring.opening import start_session
from app.measuring.plan import QUICK_INTERVAL_S, Plan, plan_to_repeat, verification_plan
from app.measuring.unattended import measure_all
from app.report.charts.legs import leg_figures
from app.report.text.glance import glance_text
from app.report.text.result import WORKING_OUT, solution_text
from app.report.text.tables import difference_words
from app.screens.check import CheckScreen
from app.screens.home import HomeScreen
from app.screens.interface import ChoiceDialog, Glidecal, HelpDialog
from app.screens.plot import ChartPlot, LegPlots
from app.screens.replay import ReplayScreen
from app.screens.result import ResultScreen
from app.settings import Settings
from calib.arrays import FloatArray
from calib.errors import NotIdentifiable
from calib.identify.solution import Solution, Subset
from calib.posterior.tool_errors import ToolErrors
from tests.app.exports.test_one_correction import shown_first
from tests.conftest import LONG, first_quick
from tests.screens.driving import SIZE, quick_plan, rows, text, until

WIDE = (120, 40)
PUBLISHED_MM = {
    "x_y+": -0.19,
    "y_x+": 0.08,
    "x_y-": 0.22,
    "y_x-": -0.34,
    "y_z+": 0.02,
    "z_y+": -0.24,
    "y_z-": 0.20,
    "z_y-": 0.45,
    "x_z+": -0.29,
    "z_x+": -0.52,
    "x_z-": 0.08,
    "z_x-": 0.62,
}
"""Experiment 2 in table 2 of the paper of 2008."""

NAMES = [difference_words(name) for name in PUBLISHED_MM]


@pytest.fixture
def published(samples: Path, tmp_path: Path) -> tuple[SessionSolution, Path]:
    """A published session in a folder of its own, solved."""
    path = tmp_path / "published.jsonl"
    path.write_bytes((samples / "experiment_2_twelve.jsonl").read_bytes())
    return solve_files([path]).work_out(), path


@pytest.fixture(scope="module")
def verified(tmp_path_factory: pytest.TempPathFactory) -> tuple[SessionSolution, Plan]:
    """A simulated machine, calibrated and measured again."""
    plan = demo_plan(tmp_path_factory.mktemp("demo"), "zero-max-min", 1)
    with start_session(plan) as guided:
        measure_all(guided)
    second = verification_plan(plan, solve_files([plan.path]))
    with start_session(second) as guided:
        measure_all(guided)
    return solve_files([second.path]).work_out(), second


def hear(interface: Glidecal, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is said in notifications from now on."""
    messages: list[str] = []
    monkeypatch.setattr(interface, "notify", lambda message, **_: messages.append(message))
    return messages


def page(interface: Glidecal) -> str:
    return interface.screen.query_one(TabbedContent).active


def offered(interface: Glidecal) -> set[str]:
    """Keys in the footer."""
    active = interface.screen.active_bindings.items()
    return {key for key, entry in active if entry.binding.show}


def drawn(interface: Glidecal, selector: str) -> list[str]:
    return str(interface.screen.query_one(selector, ChartPlot).render()).splitlines()


@LONG
@pytest.mark.parametrize("kind", ["measured", "replay", "replayed"])
async def test_the_last_line_has_room_for_help(
    published: tuple[SessionSolution, Path], kind: str
) -> None:
    result, path = published
    screens: dict[str, Callable[[], Screen[None]]] = {
        "measured": lambda: ResultScreen(result, quick_plan(path.parent), path),
        "replay": lambda: ReplayScreen(path),
        "replayed": lambda: ResultScreen(result, None, path),
    }
    interface = Glidecal(screens[kind]())
    async with interface.run_test(size=SIZE) as pilot:
        await until(pilot, "keys", lambda: bool(interface.screen.query(FooterKey)))
        await pilot.pause()
        keys = {key.key: key.region for key in interface.screen.query(FooterKey)}
        assert "f1" in keys
        assert max(region.right for region in keys.values()) <= SIZE[0]


@LONG
async def test_keys_turn_the_pages(published: tuple[SessionSolution, Path]) -> None:
    result, path = published
    interface = Glidecal(ResultScreen(result, None, path))
    async with interface.run_test(size=SIZE) as pilot:
        await until(
            pilot, "text", lambda: text(interface, "#details-text").endswith(solution_text(result))
        )
        pages = []
        for key in ("right", "right", "right", "right", "left", "tab", "shift+tab"):
            await pilot.press(key)
            await pilot.pause()
            pages.append(page(interface).removeprefix(""))
        assert pages == ["details", "plot", "legs", "result", "legs", "result", "legs"]
        await pilot.press("left", "left")
        await until(pilot, "focus", lambda: isinstance(interface.focused, VerticalScroll))
        await pilot.press("end")
        scroll = interface.screen.query_one("#details VerticalScroll", VerticalScroll)
        await until(pilot, "the end", lambda: scroll.scroll_y == scroll.max_scroll_y > 0)
        await pilot.press("f1")
        await until(pilot, "help", lambda: isinstance(interface.screen, HelpDialog))


async def test_names_points_and_zero_line_at_80_columns(
    published: tuple[SessionSolution, Path],
) -> None:
    result, path = published
    interface = Glidecal(ResultScreen(result, None, path))
    async with interface.run_test(size=SIZE) as pilot:
        await pilot.press("left", "left")
        await until(pilot, "a plot", lambda: len(drawn(interface, "#plot-chart0")) > 15)
        lines = drawn(interface, "#plot-chart0")
        assert lines[0].strip() == "Differences: leg along axis, mm"
        assert lines[-1].strip() == "x measured   o residual"
        rows = [line.partition("┤") for line in lines if "┤" in line]
        assert [name.strip() for name, _, _ in rows] == NAMES
        assert NAMES[:2] == ["Y along X, MAX", "X along Y, MAX"]
        assert all(points.count("x") == points.count("o") == 1 for _, _, points in rows)
        zero = next(line for line in lines if "│" in line[20:-1]).index("│", 20)
        pitch_mm = 1.4 / (lines[-2].rindex("0.8") - lines[-2].index("-0.6"))
        positions = [("".join(row).index("x", 16) - zero) * pitch_mm for row in rows]
        assert positions == pytest.approx(list(PUBLISHED_MM.values()), abs=0.6 * pitch_mm)


async def test_text_and_plot_side_by_side(published: tuple[SessionSolution, Path]) -> None:
    result, path = published
    interface = Glidecal(ResultScreen(result, None, path))
    async with interface.run_test(size=WIDE) as pilot:
        beside = interface.screen.query_one("#result .beside")
        await until(pilot, "two panels", lambda: beside.region.width > 30)
        text_region = interface.screen.query_one("#result VerticalScroll").region
        assert text_region.right == beside.region.x
        assert text_region.width >= 80
        lines = drawn(interface, "#result-chart0")
        labels = [line.split("┤")[0].strip() for line in lines if "┤" in line]
        assert labels == NAMES
        await pilot.resize_terminal(*SIZE)
        await until(pilot, "one panel", lambda: not beside.display)


async def test_nothing_is_drawn_twice(
    published: tuple[SessionSolution, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    result, path = published
    interface = Glidecal(ResultScreen(result, None, path), read_only=True)
    async with interface.run_test(size=SIZE) as pilot:
        await pilot.press("left", "left")
        await until(pilot, "a plot", lambda: len(drawn(interface, "#plot-chart0")) > 15)
        chart = interface.screen.query_one("#plot-chart0", ChartPlot)
        builds: list[Size] = []
        build = chart.plt.build

        def counted() -> str:
            builds.append(chart.size)
            return str(build())

        monkeypatch.setattr(chart.plt, "build", counted)
        first = chart.render()
        chart.refresh()
        await pilot.pause()
        assert builds == []
        assert chart.render() is first
        await pilot.press("s", "3")
        await until(pilot, "another chart", lambda: len(builds) == 1)
        interface.theme = "textual-light"
        await until(pilot, "other colours", lambda: len(builds) == 2)


@LONG
async def test_sets_of_parameters(published: tuple[SessionSolution, Path]) -> None:
    """Views change; what to enter stays."""
    result, path = published
    entered = shown_first(solution_text(result))
    assert len(entered) == 3
    interface = Glidecal(ResultScreen(result, None, path))
    async with interface.run_test(size=SIZE) as pilot:
        for key, words in (
            ("2", "leg lengths"),
            ("3", "joint offsets and leg lengths"),
            ("4", "both, constrained by tolerances"),
        ):
            await pilot.press("s", key)
            await pilot.pause()
            details = " ".join(text(interface, "#details-text").split())
            assert f"View: {words}, exact fit" in details
            assert shown_first(text(interface, "#details-text")) == entered
        await pilot.press("s", "1")
        await pilot.pause()
        assert text(interface, "#details-text").endswith(solution_text(result))


@LONG
async def test_what_takes_long_is_worked_out_apart(
    published: tuple[SessionSolution, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Keys are answered meanwhile; the view that was chosen is shown when it is done."""
    _, path = published
    come, result = threading.Event(), solve_files([path])
    work_out = SessionSolution.work_out

    def late(self: SessionSolution) -> SessionSolution:
        come.wait(60.0)
        return work_out(self)

    monkeypatch.setattr(SessionSolution, "work_out", late)
    interface = Glidecal(ResultScreen(result, quick_plan(path.parent), path))
    messages = hear(interface, monkeypatch)
    async with interface.run_test(size=SIZE) as pilot:
        await pilot.press("s", "2", "v")
        await pilot.pause()
        assert text(interface, "#result-text") == WORKING_OUT
        assert messages == [WORKING_OUT]
        assert not result.corrections.is_worked_out
        come.set()
        await until(pilot, "text", lambda: "View: leg lengths" in text(interface, "#details-text"))


async def test_keys_are_offered_with_the_page_that_names_them(
    published: tuple[SessionSolution, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever shows the page first, here a window of another size."""
    _, path = published
    come, done, result = threading.Event(), threading.Event(), solve_files([path])
    work_out = SessionSolution.work_out

    def slow(self: SessionSolution) -> SessionSolution:
        come.wait(60.0)
        work_out(self)
        done.wait(60.0)
        return self

    monkeypatch.setattr(SessionSolution, "work_out", slow)
    interface = Glidecal(ResultScreen(result, quick_plan(path.parent), path))
    async with interface.run_test(size=SIZE) as pilot:
        await until(pilot, "keys", lambda: "Report" in rows(interface.screen)[-1])
        assert "Verify" not in rows(interface.screen)[-1]
        come.set()
        await until(pilot, "worked out", lambda: result.corrections.is_worked_out)
        await pilot.resize_terminal(*WIDE)
        await until(pilot, "page", lambda: "Tool error" in text(interface, "#result-text"))
        await pilot.pause(0.2)
        shown = rows(interface.screen)[-1]
        done.set()
        assert "Verify" in shown


def test_pages_work_nothing_out(
    published: tuple[SessionSolution, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bounds in every frame took 0.2 to 0.4 s while nothing else was shown."""
    result, _ = published

    def asked_late(_: ToolErrors, values: FloatArray) -> float:
        raise AssertionError(f"a bound is worked out for a page: {values}")

    monkeypatch.setattr(ToolErrors, "bound_mm", asked_late)
    assert "for a touched-off workpiece" in glance_text(
        result, None, (), 76, exports=True, measures=True
    )
    assert "the machine's own frame" in solution_text(result)


async def test_a_set_that_is_not_seen_is_refused(
    published: tuple[SessionSolution, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    result, path = published
    unseen = NotIdentifiable("set [both]", "two differences", "six")
    refused: dict[Subset, NotIdentifiable | Solution] = {"both": unseen, "joint-offsets": unseen}
    result = result.with_subset("with-tolerances")
    identified = result.choice.identified | refused
    result = replace(result, choice=replace(result.choice, identified=identified))
    interface = Glidecal(ResultScreen(result, quick_plan(path.parent), path))
    messages = hear(interface, monkeypatch)
    async with interface.run_test(size=SIZE) as pilot:
        for key in ("3", "1"):
            await pilot.press("s", key)
        await until(pilot, "two refusals", lambda: len(messages) == 2)
        assert all("set [both]" in message for message in messages)
        assert text(interface, "#details-text").endswith(solution_text(result))
        assert isinstance(interface.screen, ResultScreen)
    assert sorted(p.name for p in path.parent.iterdir()) == ["published.jsonl"]


async def test_export_names_what_it_wrote(
    published: tuple[SessionSolution, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    result, path = published
    interface = Glidecal(ResultScreen(result, None, path))
    messages = hear(interface, monkeypatch)
    async with interface.run_test(size=SIZE) as pilot:
        await pilot.press("e")
        await until(pilot, "written", lambda: bool(messages))
        await until(
            pilot, "caution", lambda: "\nWARNING: the present" in text(interface, "#result-text")
        )
    file_names = sorted(p.name for p in path.with_suffix("").iterdir())
    assert "offsets.csv" in file_names
    assert all(name in messages[0] for name in file_names)


async def test_what_was_written_lies_over_nothing(
    published: tuple[SessionSolution, Path],
) -> None:
    """After E the first page with its caution still fits the smallest terminal, above the line.

    In a doubtful session, whose path takes more than a line.
    """
    folder = published[1].parent / ("a folder with a long name " * 4).strip()
    folder.mkdir()
    path = published[1].rename(folder / published[1].name)
    screen = ResultScreen(published[0], quick_plan(folder), path)
    interface = Glidecal(screen)
    async with interface.run_test(size=SIZE, notifications=True) as pilot:
        await pilot.press("e")
        message, first = (
            interface.screen.query_one(f"#{name}") for name in ("message", "result VerticalScroll")
        )
        await until(pilot, "written", lambda: "calib_joint2.inc" in text(interface, "#message"))
        words = "Next: enter the values in the controller; then V"
        await until(pilot, "next", lambda: words in text(interface, "#result-text"))
        await pilot.pause()
        assert message.region.y >= first.region.bottom
        assert message.region.bottom <= interface.screen.query_one(Footer).region.y
        assert first.max_scroll_y == 0
        assert not interface.screen.query(Toast)


async def test_export_asks_before_it_replaces(
    published: tuple[SessionSolution, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    result, path = published
    own_file = path.with_suffix("") / "offsets.csv"
    own_file.parent.mkdir()
    own_file.write_text("mine", encoding="utf-8")
    interface = Glidecal(ResultScreen(result, None, path))
    messages = hear(interface, monkeypatch)
    async with interface.run_test(size=SIZE) as pilot:
        for answer in ("1", "2"):
            await pilot.press("e")
            await until(pilot, "question", lambda: isinstance(interface.screen, ChoiceDialog))
            assert f"{own_file} is there already" in str(
                interface.screen.query(Static).first().content
            )
            assert [entry.name for entry in own_file.parent.iterdir()] == [own_file.name]
            assert own_file.read_text(encoding="utf-8") == "mine"
            await pilot.press(answer)
        await until(pilot, "written", lambda: bool(messages))
    assert own_file.read_text(encoding="utf-8") != "mine"


@LONG
async def test_report_asks_before_it_replaces(
    published: tuple[SessionSolution, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    result, path = published
    own_file = path.with_suffix(".html")
    interface = Glidecal(ResultScreen(result, None, path))
    messages = hear(interface, monkeypatch)
    async with interface.run_test(size=SIZE) as pilot:
        own_file.write_text("mine", encoding="utf-8")
        await pilot.press("r")
        await until(pilot, "question", lambda: isinstance(interface.screen, ChoiceDialog))
        await pilot.press("1")
        assert own_file.read_text(encoding="utf-8") == "mine"
        await pilot.press("r")
        await until(pilot, "question", lambda: isinstance(interface.screen, ChoiceDialog))
        await pilot.press("2")
        await until(
            pilot, "written", lambda: any("Report written" in message for message in messages)
        )
    assert "Calibration report" in own_file.read_text(encoding="utf-8")


async def test_export_that_the_disk_refuses(
    published: tuple[SessionSolution, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    result, path = published
    path.with_suffix("").write_text("a file where the folder must be")
    interface = Glidecal(ResultScreen(result, None, path))
    messages = hear(interface, monkeypatch)
    async with interface.run_test(size=SIZE) as pilot:
        await pilot.press("e")
        await until(pilot, "refusal", lambda: bool(messages))
        assert "a place with write permission" in messages[0]


async def test_a_program_that_only_shows(
    published: tuple[SessionSolution, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    result, path = published
    interface = Glidecal(ResultScreen(result, quick_plan(path.parent), path), read_only=True)
    messages = hear(interface, monkeypatch)
    async with interface.run_test(size=SIZE) as pilot:
        await pilot.pause()
        assert {"d", "w", "escape", "f10"} <= offered(interface)
        assert not {"e", "v", "r"} & offered(interface)
        await pilot.press("e", "v", "r")
        await until(pilot, "three refusals", lambda: len(messages) == 3)
        assert all("nothing is written and nothing is measured" in message for message in messages)
        assert ["/reports" in message for message in messages] == [False, False, True]
        assert isinstance(interface.screen, ResultScreen)
    assert [p.name for p in path.parent.iterdir()] == ["published.jsonl"]


async def test_verify_needs_the_plan_of_the_session(
    published: tuple[SessionSolution, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    result, path = published
    interface = Glidecal(ResultScreen(result, None, path))
    messages = hear(interface, monkeypatch)
    async with interface.run_test(size=SIZE) as pilot:
        await pilot.pause()
        assert "e" in offered(interface)
        assert "v" not in offered(interface)
        await pilot.press("v")
        await until(pilot, "refusal", lambda: bool(messages))
        assert "cannot be measured again from here" in messages[0]
        assert isinstance(interface.screen, ResultScreen)


@LONG
async def test_any_finished_session_can_be_verified_later(samples: Path, tmp_path: Path) -> None:
    """After a restart the record alone tells machine, procedure, indicators; a table cannot."""
    plan = quick_plan(tmp_path)
    with start_session(replace(plan, interval_s=QUICK_INTERVAL_S)) as guided:
        measure_all(guided)
    again = plan_to_repeat(guided.path)
    assert again is not None
    assert (again.procedure, again.instruments) == (plan.procedure, plan.instruments)
    assert plan_to_repeat(samples / "experiment_2_twelve.jsonl") is None
    result = solve_files([guided.path]).work_out()
    interface = Glidecal(ResultScreen(result, again, guided.path))
    async with interface.run_test(size=SIZE) as pilot:
        await until(pilot, "verify offered", lambda: "v" in offered(interface))
        await pilot.press("v")
        await until(pilot, "the check", lambda: isinstance(interface.screen, CheckScreen))
    planned = verification_plan(again, result)
    assert planned.verifies == guided.path.name
    assert planned.machine.entered_offsets_mm == pytest.approx(result.joint_offsets_mm)


async def test_another_key_of_the_settings(published: tuple[SessionSolution, Path]) -> None:
    result, path = published
    settings = Settings(keys={"result.export": "x"})
    interface = Glidecal(ResultScreen(result, None, path), settings=settings)
    async with interface.run_test(size=SIZE) as pilot:
        await pilot.pause()
        assert "x" in offered(interface)
        await pilot.press("x")
        await until(pilot, "written", lambda: (path.with_suffix("") / "offsets.csv").exists())


async def test_copy_says_how_much(
    published: tuple[SessionSolution, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    result, path = published
    interface = Glidecal(ResultScreen(result, None, path))
    messages = hear(interface, monkeypatch)
    async with interface.run_test(size=SIZE) as pilot:
        await pilot.press("right", "y")
        await until(pilot, "words", lambda: bool(messages))
    assert interface.clipboard.endswith(solution_text(result))
    assert messages[0].startswith(f"{len(interface.clipboard.splitlines())} lines copied")
    assert "set-clipboard on" in messages[0]


async def test_home(
    published: tuple[SessionSolution, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    result, path = published
    monkeypatch.chdir(path.parent)
    interface = Glidecal(ResultScreen(result, None, path))
    async with interface.run_test(size=SIZE) as pilot:
        await pilot.press("escape")
        await until(pilot, "home", lambda: isinstance(interface.screen, HomeScreen))
        assert "What do you want to do?" in text(interface, "#question")


@LONG
async def test_comparison_is_a_page_of_its_own(verified: tuple[SessionSolution, Plan]) -> None:
    result, plan = verified
    assert plan.before is not None
    before, after = plan.before.solution.rms_before_mm, result.solution.rms_before_mm
    interface = Glidecal(ResultScreen(result, plan, plan.path))
    async with interface.run_test(size=SIZE) as pilot:
        await until(pilot, "text", lambda: "Next: " in text(interface, "#result-text"))
        assert page(interface) == "result"
        first = text(interface, "#result-text")
        compared = text(interface, "#before-after-text")
        assert f"from {before:.4f} to {after:.4f} mm" in compared
        assert first.startswith(compared.splitlines()[0])
        helps = result.entered.helps  # the scatter is another each time
        assert ("Add to the offsets" in first) is helps
        assert ("Nothing to enter" in first) is not helps
        await pilot.press("left")
        await until(pilot, "a plot", lambda: len(drawn(interface, "#before-after-chart0")) > 15)
        assert page(interface) == "before-after"
        lines = drawn(interface, "#before-after-chart0")
        assert lines[-1].strip() == "x before   o after"
        assert [line.split("┤")[0].strip() for line in lines if "┤" in line] == NAMES
        await pilot.press("y")
        assert interface.clipboard == compared
        await pilot.press("right")
        await pilot.pause()
        assert page(interface) == "result"


async def test_a_result_without_verification_has_no_such_page(
    published: tuple[SessionSolution, Path],
) -> None:
    result, path = published
    interface = Glidecal(ResultScreen(result, quick_plan(path.parent), path))
    async with interface.run_test(size=SIZE) as pilot:
        await pilot.pause()
        assert not interface.screen.query("#before-after")
        assert "\nNext: D looks for what is missing" in text(interface, "#result-text")
        await pilot.press("v")
        await until(pilot, "check", lambda: isinstance(interface.screen, CheckScreen))
        await until(pilot, "open", lambda: interface.indicators is not None)
        assert "exported offsets must now be in the controller" in text(interface, "#words")


@pytest.mark.parametrize("size", first_quick([(80, 24), (120, 40)]))
async def test_legs_are_turned_by_plus_and_minus(
    published: tuple[SessionSolution, Path], size: tuple[int, int]
) -> None:
    """Six pictures; where there is room, the next one stands beside."""
    interface = Glidecal(ResultScreen(published[0], None, published[1]))
    titles = [leg.title for leg in leg_figures(published[0])]

    def shown() -> list[str]:
        places = interface.screen.query(f"{LegPlots.__name__} Vertical")
        parts = [place.query(ChartPlot).first() for place in places if place.display]
        return [str(part.render()).splitlines()[0].strip() for part in parts]

    def expected(first: int) -> list[str]:
        return [
            f"{titles[k % 6]} ({k % 6 + 1} of 6), mm"
            for k in range(first, first + 1 + (size == WIDE))
        ]

    async with interface.run_test(size=size) as pilot:
        await pilot.press("plus")
        await until(pilot, "the pictures", lambda: bool(shown()[0]))
        first = titles.index(shown()[0].split(" (")[0])
        for by in (1, -1, -1, -1):
            await pilot.press("plus" if by > 0 else "minus")
            await pilot.pause()
            first += by
            assert page(interface) == "legs"
            assert shown() == expected(first)
