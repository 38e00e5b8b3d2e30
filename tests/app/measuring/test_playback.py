"""Replaying without a screen: time, places, words, and what the panels showed."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.measuring.gauges import Live, Motion
from app.measuring.playback import BREAK_S, SHORTEST_S, SPEEDS, Playback, PlaybackState, frames_of
from app.report.text.replay import reading_lines, said_text
from calib.errors import RecordError, UsageError
from drivers.profile import Fault, FaultKind, IndicatorReading
from protocols.record import Record, read_record
from protocols.session import Event, fold
from protocols.session import Reading as Recorded
from tests.app.cli import refused
from tests.conftest import LONG, SAMPLES
from tests.recorded import REASON, at, opened, pair, story

WHOLE = sorted(p for p in SAMPLES.glob("*.jsonl") if p.name != "damaged.jsonl")


def record(events: list[Event]) -> Record:
    """A record of these events that was never closed."""
    placed = [event.model_copy(update={"line": n}) for n, event in enumerate(events, start=1)]
    return Record(Path("folder/story.jsonl"), tuple(placed), "open", 0, 0, "")


def shown(live: Live) -> list[float]:
    """The readings of the strip chart."""
    assert all(low == high for _, low, high in live.trace().moments)
    return [high for _, _, high in live.trace().moments]


def told() -> Playback:
    return Playback(record(story()))


@pytest.mark.parametrize("path", WHOLE, ids=lambda path: path.stem)
def test_every_sample_plays_to_the_end(path: Path) -> None:
    file_record = read_record(path)
    playback = Playback(file_record)
    playback.faster(-len(SPEEDS))
    playback.toggle()
    positions = {playback.position}
    for _ in range(100_000):
        if playback.state is PlaybackState.END:
            break
        playback.advance(0.5)
        positions.add(playback.position)
    assert playback.state is PlaybackState.END
    assert playback.position == len(file_record.events)
    assert playback.session == fold(file_record.events)
    assert positions == {frame.end for frame in playback.frames}
    closed = f"Closed with {len(playback.session.all_readings)} readings"
    assert said_text(playback).startswith(closed)


def test_samples_are_there() -> None:
    assert len(WHOLE) >= 9


def test_a_record_in_words_one_moment_after_the_other() -> None:
    playback = told()
    moments = []
    for _ in playback.frames:
        moments.append((playback.place, said_text(playback)))
        playback.step(1)
    warning = "story.jsonl: not closed after line 16; the session is not finished."
    assert moments == [
        ("step 1 of 30", f"Begun 2026-03-01 08:00 UTC by Ida, measured. {warning}"),
        ("step 1 of 30", "Mounted on leg X along Y and Z: a new zero."),
        ("step 1 of 30", "Taken, step 1: Y +0.1000 mm, Z -0.1000 mm"),
        ("step 2 of 30", "Taken, step 2: Y +0.2000 mm, Z -0.2000 mm"),
        ("step 2 of 30", "Note: the stand slipped [red]here[/]"),
        ("step 2 of 30", f"Superseded readings 3, 4: {REASON}"),
        ("step 2 of 30", "Fault of the indicator along Z, step 2: no answer (received 'E[1]')"),
        ("step 2 of 30", "Taken, step 2: Y +0.2000 mm, Z -0.2000 mm"),
        ("step 4 of 30", "Skipped steps 3: out of reach"),
        ("step 4 of 30", "Continued after an interruption."),
        ("step 4 of 30", "Mounted on leg X along Y and Z: a new zero."),
        ("step 4 of 30", f"Taken, step 4: Y +0.4000 mm, Z -0.4000 mm {warning}"),
    ]


def test_time_is_that_of_the_events_and_breaks_are_short() -> None:
    times_s = [frame.time_s for frame in told().frames]
    gaps_s = [after - before for before, after in pairwise(times_s)]
    assert gaps_s == [20, SHORTEST_S, 20, 5, 5, 5, 5, 10, BREAK_S, 10, SHORTEST_S]


def test_imported_tables_play_at_an_even_pace(samples: Path) -> None:
    events = read_record(samples / "experiment_1_six.jsonl").events
    times_s = [frame.time_s for frame in frames_of(events)]
    assert times_s == [*(2.0 * k for k in range(13)), 25.0]


def test_simulated_readings_play_by_their_own_times(samples: Path) -> None:
    file_record = read_record(samples / "simulated_zero-max-min.jsonl")
    frames = frames_of(file_record.events)
    stated = [e.time_s for frame in frames for e in frame.events[:1] if isinstance(e, Recorded)]
    assert stated == [20.0 * k for k in range(1, 31)]
    times_s = [frame.time_s - frames[1].time_s for frame in frames[1:-1]]
    assert times_s == pytest.approx([20.0 * k for k in range(30)])


def test_a_clock_that_was_set_back_does_not_stop_the_replay() -> None:
    events = [opened(), *pair(1, 1, 0.0, 500), *pair(3, 2, 60.0, 20)]
    assert [frame.time_s for frame in frames_of(events)] == [0.0, BREAK_S, BREAK_S + SHORTEST_S]


def test_speeds() -> None:
    playback = told()
    playback.faster(-len(SPEEDS))
    speeds = []
    for _ in SPEEDS:
        speeds.append(playback.speed)
        playback.faster()
    assert speeds == [1, 2, 5, 10, 20, 50, 100]
    assert playback.speed == 100


@pytest.mark.parametrize("speed", SPEEDS)
def test_time_passes_at_the_speed(speed: int) -> None:
    playback = told()
    playback.faster(-len(SPEEDS))
    playback.faster(SPEEDS.index(speed))
    assert playback.advance(20.0 / speed) is False
    assert playback.position == 1
    playback.toggle()
    assert playback.advance(19.9 / speed) is False
    assert playback.advance(0.2 / speed) is True
    assert playback.time_s == pytest.approx(20.1)
    assert playback.position == 2
    playback.toggle()
    assert playback.state is PlaybackState.PAUSED
    assert playback.advance(100.0) is False


def test_the_first_speed_lets_a_usual_step_be_seen(samples: Path) -> None:
    assert told().speed == 5
    assert Playback(read_record(samples / "simulated_sweep.jsonl")).speed == 20
    assert Playback(read_record(samples / "experiment_1_six.jsonl")).speed == 2


def test_play_at_the_end_begins_again() -> None:
    playback = told()
    playback.go(len(playback.frames))
    assert playback.state is PlaybackState.END
    playback.toggle()
    assert (playback.state, playback.position) == (PlaybackState.PLAYING, 1)
    playback.advance(10_000.0)
    assert (playback.state, playback.position) == (PlaybackState.END, 16)


def test_a_record_of_one_line_is_at_its_end() -> None:
    playback = Playback(record([opened()]))
    playback.toggle()
    assert playback.state is PlaybackState.END
    assert playback.advance(1.0) is False
    assert playback.place == "step 1 of 30"
    assert [live.motion for live in playback.live] == [Motion.WAITING] * 2


def test_jump_to_a_step() -> None:
    playback = told()
    playback.jump_to(" 2 ")
    assert playback.session.done() == {1, 2}
    assert playback.session.superseded == {}
    playback.jump_to("3")
    assert said_text(playback) == "Skipped steps 3: out of reach"
    playback.jump_to("1")
    assert playback.session.done() == {1}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("5", "found 5, which was never taken"),
        ("31", "found 31. Allowed: 1 … 30"),
        ("0", "found 0. Allowed: 1 … 30"),
        ("-2", "found -2. Allowed: 1 … 30"),
        ("²", "found '²'. Allowed: a whole number"),
        ("two", "found 'two'. Allowed: a whole number"),
        ("9" * 5000, "Allowed: a whole number"),
    ],
)
def test_jump_to_nowhere_is_refused(text: str, words: str) -> None:
    playback = told()
    playback.jump_to("2")
    with pytest.raises(UsageError) as refused:
        playback.jump_to(text)
    assert words in str(refused.value)
    assert playback.place == "step 2 of 30"


def test_jump_in_a_table_counts_readings(samples: Path) -> None:
    playback = Playback(read_record(samples / "experiment_2_twelve.jsonl"))
    playback.jump_to("3")
    assert playback.place == "reading 3 of 18"
    assert said_text(playback) == "Reading 3, leg X at -100.00 mm: Y -0.3400 mm"
    assert [r.reading for r in playback.session.readings] == [1, 2, 3]
    assert all(r.step is None for r in playback.session.readings)
    assert playback.shown.done() == {1, 2, 3}
    now = playback.now
    assert now is not None
    assert (now.number, now.leg, now.axes, now.displacement_mm) == (3, "x", ("y",), -100.0)
    assert not playback.shown.is_new_place(now)
    (live,) = playback.live
    assert shown(live) == [0.0, 0.08, -0.34]
    assert isinstance(live.outcome, IndicatorReading)
    assert live.outcome.resolution_mm == pytest.approx(0.01)
    playback.step(1)
    assert shown(playback.live[0]) == [0.0]


def test_superseded_readings_stay_in_sight_with_their_reason() -> None:
    playback = told()
    playback.jump_to("2")
    assert not any("superseded" in line for line in reading_lines(playback.session))
    playback.go(len(playback.frames))
    lines = reading_lines(playback.session)
    assert len(lines) == 1 + 8 + 2
    third = next(k for k, line in enumerate(lines) if line.split()[:1] == ["3"])
    assert lines[third].split() == ["3", "2", "x", "y", "+60.00", "1", "xy", "+0.2000"]
    assert lines[third + 1].strip() == f"superseded: {REASON}"
    assert shown(playback.live[0]) == [0.4]


def test_panels_show_readings_of_the_present_mounting() -> None:
    playback = told()
    assert [live.motion for live in playback.live] == [Motion.WAITING] * 2
    playback.jump_to("2")
    assert [shown(live) for live in playback.live] == [[0.1, 0.2], [-0.1, -0.2]]
    assert playback.live[0].outcome == IndicatorReading("0.200", 0.2, 0.001, unit_assumed=False)
    playback.toggle()
    playback.advance(4.0 / playback.speed)
    assert [live.age_s for live in playback.live] == [4.0, 4.0]
    assert [live.motion for live in playback.live] == [Motion.STABLE] * 2
    playback.step(3)
    first, second = playback.live
    assert first.motion is Motion.STABLE
    assert second.motion is Motion.FAULT
    assert second.outcome == Fault(FaultKind.NO_ANSWER, "E[1]", "no answer")
    playback.step(4)
    assert said_text(playback).startswith("Mounted")
    assert [live.motion for live in playback.live] == [Motion.WAITING] * 2


def test_the_step_to_take_is_shown_after_a_break() -> None:
    playback = told()
    playback.step(9)
    now = playback.now
    assert now is not None
    assert now.number == 4
    assert not playback.session.stand_untouched


def test_half_a_step_is_shown_as_it_is() -> None:
    half = pair(1, 1, 0.0, 20)[:1]
    playback = Playback(record([opened(), *half]))
    playback.go(len(playback.frames))
    assert said_text(playback).startswith("Taken, step 1: Y +0.1000 mm story.jsonl: not closed")
    assert [live.motion for live in playback.live] == [Motion.STABLE, Motion.WAITING]


def test_a_torn_record_says_where_it_is_cut(samples: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.jsonl"
    cut.write_bytes((samples / "simulated_sweep.jsonl").read_bytes()[:9000])
    file_record = read_record(cut)
    playback = Playback(file_record)
    lines = len(file_record.events)
    warning = f"cut.jsonl: cut inside line {lines + 1}; used up to line {lines}."
    assert said_text(playback).endswith(warning)
    playback.step(1)
    assert warning not in said_text(playback)
    playback.go(len(playback.frames))
    assert said_text(playback).endswith(warning)


def test_a_tick_lets_the_time_pass_that_passed(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, playback = SimpleNamespace(now_s=7.0), told()
    monkeypatch.setattr(
        "app.measuring.playback.time", SimpleNamespace(monotonic=lambda: clock.now_s)
    )
    playback.tick()
    playback.toggle()
    assert playback.tick() is False
    clock.now_s += 1_000.0
    assert playback.tick() is True
    assert playback.time_s > 0.0


def test_there_is_a_panel_for_each_indicator_that_the_steps_need(samples: Path) -> None:
    playback = told()
    assert playback.instruments == playback.record.opened.instruments
    table = Playback(read_record(samples / "experiment_2_twelve.jsonl"))
    assert [instrument and instrument.profile for instrument in table.instruments] == ["table"]


def test_the_session_is_folded_once_a_place() -> None:
    playback = told()
    assert playback.session is playback.session
    assert playback.shown is playback.shown
    before = playback.shown
    playback.step(1)
    assert playback.shown is not before


MOVES = st.one_of(
    st.tuples(st.just("step"), st.integers(-3, 3)),
    st.tuples(st.just("go"), st.sampled_from([0, 99])),
    st.tuples(st.just("advance"), st.floats(0.0, 30.0)),
    st.tuples(st.just("jump_to"), st.sampled_from(["1", "2", "3", "4", "9"])),
    st.tuples(st.sampled_from(["toggle", "pause", "faster"]), st.none()),
)


def move(playback: Playback, name: str, value: float | str | None) -> None:
    action = getattr(playback, name)
    try:
        action() if value is None else action(value)
    except UsageError:
        assert (name, value) == ("jump_to", "9")


@LONG
@given(st.lists(MOVES, max_size=30))
def test_any_way_leads_to_the_same_picture(moves: list[tuple[str, float | str | None]]) -> None:
    playback = told()
    ends = [frame.end for frame in playback.frames]
    for name, value in moves:
        move(playback, name, value)
        assert playback.session == fold(playback.record.events[: playback.position])
        frame = ends.index(playback.position)
        assert playback.frames[frame].time_s <= playback.time_s
        if frame + 1 < len(ends):
            assert playback.time_s < playback.frames[frame + 1].time_s
        assert (playback.state is PlaybackState.END) == (frame + 1 == len(ends))
        assert all(live.age_s >= 0.0 for live in playback.live)
        straight = told()
        straight.step(frame)
        assert (straight.place, said_text(straight)) == (playback.place, said_text(playback))
        assert straight.shown == playback.shown
        assert [live.outcome for live in straight.live] == [live.outcome for live in playback.live]


def everything(playback: Playback) -> tuple[object, ...]:
    traces = [live.trace() for live in playback.live]
    return playback.position, said_text(playback), playback.live, traces, playback.shown


@given(st.integers(0, 11))
def test_one_forward_and_one_back_changes_nothing(frame: int) -> None:
    playback = told()
    playback.step(frame)
    before = everything(playback)
    playback.step(1)
    playback.step(-1 if frame < len(playback.frames) - 1 else 0)
    assert everything(playback) == before


def test_a_machine_that_does_not_allow_its_procedure_is_refused_in_words() -> None:
    first = opened()
    assert first.procedure is not None
    wide = first.procedure.model_copy(update={"levels": ("zero", 400.0)})
    broken = first.model_copy(update={"procedure": wide})
    with pytest.raises(RecordError, match="the joint limits"):
        Playback(replace(record([first]), events=(broken,)))


def test_times_of_the_story_are_as_written() -> None:
    assert (at(3670) - at(70)).total_seconds() == 3600.0


def test_without_a_screen_one_session_is_shown() -> None:
    first, second = WHOLE[:2]
    assert "found 2 sessions. Allowed: one session" in refused(2, "replay", first, second, "--json")
    assert "no terminal" in refused(2, "replay", first, second)
