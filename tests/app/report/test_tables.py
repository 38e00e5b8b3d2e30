"""How lines of texts break, and what paragraphs are made of."""

from __future__ import annotations

from app.evaluating.solution import LineParameter
from app.report.text.tables import expanded, free_words, hanging, new_table, paragraphs, wrapped
from calib.identify.solution import Difference
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


def test_differences_have_the_decimals_of_their_uncertainty() -> None:
    """Before: three decimals beside a u of four."""
    rows = [Difference(0.12345, u, 0.12, 0.00346) for u in (0.0018, 0.018)]
    cells = list(DataTable.of(Difference, rows).reader_rows())
    assert cells == [
        ("+0.1235", "0.0018", "+0.1200", "+0.0035"),
        ("+0.123", "0.018", "+0.120", "+0.003"),
    ]


def test_a_value_ends_with_the_second_digit_of_its_uncertainty() -> None:
    assert expanded(-7.146, 11.0) == "-7 ± 22"
    assert expanded(712.4, 112.0) == "+710 ± 220"
    assert expanded(0.050184, 0.00055) == "+0.0502 ± 0.0011"


def test_degrees_of_freedom_that_nobody_counted_are_effective() -> None:
    """Before: 91 of a contact whose repeats have 60."""
    assert free_words(60.0, 60.0) == "60 degrees of freedom"
    assert free_words(91.0, 60.0) == "91 effective degrees of freedom"
    assert free_words(8.71) == "8.71 effective degrees of freedom"
