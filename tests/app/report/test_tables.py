"""How lines of texts break, and what paragraphs are made of."""

from __future__ import annotations

from app.evaluating.solution import LineParameter
from app.report.text.tables import hanging, new_table, paragraphs, wrapped
from protocols.data_table import DataTable

NAME = "simulated_zero-max-min-plane-of-the-second-of-june.jsonl"


def test_a_name_with_hyphens_stays_whole() -> None:
    """Whoever copies it to a command needs all of it."""
    warning = f"WARNING: session {NAME}: found a line that was changed"
    assert NAME in hanging(f"  in these few words before {warning}", "  ")
    assert NAME in wrapped(f"in these few words before {warning}")


def test_paragraphs_break_sentences_and_keep_lines() -> None:
    table = new_table("name", "value")
    table.add_row(NAME, "1")
    line = f"glidecal solve {NAME} --model {NAME}"
    paragraph, kept_line, shown_table = paragraphs("word " * 30, "", [], [line], table).split(
        "\n\n"
    )
    assert len(paragraph.splitlines()) == 2
    assert kept_line == line
    assert shown_table.splitlines()[0].split() == ["name", "value"]


def test_an_id_takes_the_room_of_the_key_in_its_place() -> None:
    words = "{diagnose.adopt} adopts what was named. Then {diagnose.result} shows the result of it."
    assert wrapped(words) == words, "with A and R it is 58 letters"
    text = wrapped(f"{words} {words}")
    assert text.count("\n") == 1
    assert text.replace("\n", " ") == f"{words} {words}"


def test_lines_of_drives_have_the_digits_of_their_uncertainty() -> None:
    """Two digits of U (GUM 7.2.6), and the value as many decimals. Before: four decimals always."""
    lines = [
        LineParameter("axis_offset", "xr", 0.10222, 0.34719, 0.4, "mm"),
        LineParameter("axis_lean", "yt", -0.0012345, 0.00004567, 1.0, "mrad"),
    ]
    cells = [row[2:4] for row in DataTable.of(LineParameter, lines).reader_rows()]
    assert cells == [("+0.10", "0.35"), ("-0.001234", "0.000046")]
