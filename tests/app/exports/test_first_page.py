"""The first page of a result: what it shows is written and printed; its next key, its bars."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import glidecal
from app.evaluating.solution import SessionSolution, solve_files, solve_sessions
from app.report.charts.bars import bar_rows
from app.report.text.glance import Done, glance_text, next_text
from protocols.effect_entries import EffectEntry, ParameterEntry
from protocols.model_file import ModelFile
from protocols.record import read_record
from tests.app.exports.first_page import differences, printer, printer_differences, simulated
from tests.conftest import LONG, first_quick


@pytest.mark.parametrize("seed", first_quick([1, 7, 14]))
def test_what_is_shown_first_is_written_printed_and_judged(tmp_path: Path, seed: int) -> None:
    path = simulated(tmp_path, seed)
    assert read_record(path).end == "closed"
    assert differences(path) == []


@LONG
@pytest.mark.parametrize("seed", first_quick([2, 3, 5]))
def test_what_is_shown_of_a_printer_is_written(tmp_path: Path, seed: int) -> None:
    assert printer_differences(printer(tmp_path, seed)) == []


@pytest.fixture
def solved(samples: Path) -> Callable[[str], SessionSolution]:
    return lambda name: solve_files([samples / f"{name}.jsonl"]).work_out()


@LONG
def test_next_is_always_the_next_thing(solved: Callable[[str], SessionSolution]) -> None:
    sound, doubtful = solved("simulated_zero-max-min"), solved("experiment_2_twelve")

    def key(of: SessionSolution, *done: Done, measures: bool = True) -> str:
        words = next_text(of, done, exports=True, measures=measures)
        return words.partition("{result.")[2].partition("}")[0]

    assert key(sound) == "export"
    assert key(sound, Done.EXPORTED) == "verify"
    assert key(sound, Done.EXPORTED, measures=False) == "report"
    assert key(sound, Done.EXPORTED, Done.REPORTED) == "verify"
    assert key(sound, Done.EXPORTED, Done.REPORTED, measures=False) == "", "it is written"
    assert key(doubtful) == "diagnose"
    assert key(doubtful, Done.REPORTED) == "diagnose"
    assert key(doubtful, Done.DIAGNOSED) == "export"
    assert key(doubtful, Done.DIAGNOSED, Done.EXPORTED) == "verify"
    assert next_text(sound, (), exports=False, measures=True) == ""


def test_what_is_not_to_be_entered_is_not_added(
    solved: Callable[[str], SessionSolution], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One truth on the page: whatever was done, nobody is told to enter the values."""
    sound = solved("simulated_zero-max-min")
    for helps in (True, False):
        monkeypatch.setattr(type(sound.entered), "helps", helps)
        for done in ((), (Done.EXPORTED,)):
            page = glance_text(sound, sound, done, 76, exports=True, measures=True)
            assert page.startswith("Leg deviations went from")
            assert ("Nothing to enter" in page) != helps
            assert (" enter  " in page) == helps, "no heading asks for what is not entered"
            next_words = page[page.index("\nNext:") :]
            assert ("enter the values" in next_words or "{result.export}" in next_words) == helps
        reported = glance_text(sound, sound, (Done.REPORTED,), 76, exports=True, measures=True)
        assert helps or "{result.report}" not in reported, "it is written"


def test_a_session_that_is_not_finished_is_continued_first(samples: Path, tmp_path: Path) -> None:
    lines = (samples / "simulated_zero-max-min.jsonl").read_text(encoding="utf-8").splitlines(True)
    for name, count, continued in (("cut", 20, True), ("open", -1, False)):
        path = tmp_path / f"{name}.jsonl"
        path.write_text("".join(lines[:count]), encoding="utf-8")
        interrupted = solve_files([path])
        words = next_text(interrupted, (), exports=True, measures=True)
        assert words.startswith("Next: measure the remaining steps") == continued
        assert "remaining" not in next_text(interrupted, (), exports=False, measures=True)


def test_more_than_offsets_is_proposed_where_it_leaves_clearly_less(tmp_path: Path) -> None:
    """Not of a sound machine whose kinematics would leave 0.0064 instead of 0.0069 mm."""
    play = {"play": ParameterEntry(value=0.1, unit="mm")}
    worn = ModelFile(effects=(EffectEntry(id="backlash", where="x", parameters=play),))
    (tmp_path / "worn.json").write_text(worn.text(), encoding="utf-8")
    for model, proposed in ((None, False), (tmp_path / "worn.json", True)):
        session = glidecal.simulate("zero-max-min", model=model, seed=4)
        of_session = solve_sessions([session])
        assert not of_session.entered.helps
        done = () if model is None else (Done.DIAGNOSED,)
        words = next_text(of_session, done, exports=True, measures=False)
        assert ("beside joint offsets" in words) == proposed
        assert ("change nothing" in words) != proposed


@pytest.mark.parametrize("columns", [36, 76])
def test_no_line_of_bars_is_longer_than_the_page(
    solved: Callable[[str], SessionSolution], columns: int
) -> None:
    page = glance_text(
        solved("simulated_zero-max-min"), None, (), columns, exports=True, measures=True
    )
    bars = [line for line in page.splitlines() if line.startswith(("now ", "after "))]
    assert [len(bar) <= columns for bar in bars] == [True, True]


def test_bars_are_as_long_as_their_lengths() -> None:
    now, after, words = bar_rows(
        [("now", "0.4 mm", 0.4), ("after", "0.1 mm", 0.1)], 41, ("tolerance 0.2 mm", 0.2)
    )
    start = len("after  0.4 mm  ")
    assert now[start:] == "█" * 20 + "│" + "█" * 19
    assert after[start:] == "█" * 10 + " " * 10 + "│"
    assert words == " " * (start + 20) + "│ tolerance 0.2 mm"


def test_a_mark_at_the_end_has_its_words_before_it() -> None:
    bar, words = bar_rows([("now", "0.001 mm", 0.001)], 30, ("tolerance 5 mm", 5.0))
    assert bar.endswith("│")
    assert bar.count("▏") == 1, "what is not nothing is seen"
    assert words.endswith("tolerance 5 mm │")
    assert len(words) == len(bar)
