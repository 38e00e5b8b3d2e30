"""The guided session from several threads at once: a record has one order."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path

from app.bench import BenchSettings
from app.demo import demo_plan, measure_all
from app.opening import start_session
from protocols.record import read_record
from protocols.session import fold

NOTES = 40


def test_notes_while_readings_are_taken(tmp_path: Path) -> None:
    plan = replace(demo_plan(tmp_path, "zero-max-min", 1, BenchSettings()), interval_s=0.0)
    with start_session(plan) as guided:

        def write() -> None:
            for _ in range(NOTES):
                guided.note("meanwhile")

        writers = [threading.Thread(target=write) for _ in range(2)]
        for writer in writers:
            writer.start()
        while guided.take() is not None:
            guided.go()
        for writer in writers:
            writer.join()
        assert not guided.closed
        measure_all(guided)
        assert guided.closed
    record = read_record(plan.path)
    assert record.end == "closed"
    assert sum(event.event == "noted" for event in record.events) == 2 * NOTES
    assert len(fold(record.events).readings) == 60
