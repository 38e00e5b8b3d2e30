"""The figures of docs/benchmarks.md on the measured heights of a real printer."""

from __future__ import annotations

import re
from functools import partial

import pytest

from tests.blind.public_contacts import HEIGHTS, LOOSE_MM, Printer, rms
from tests.conftest import LONG, ROOT

pytestmark = pytest.mark.skipif(not HEIGHTS.is_dir(), reason="no shared/data/deltas")

PAGE = ROOT / "docs" / "benchmarks.md"
ROUNDED_MM = 0.001


@pytest.fixture(scope="module")
def printer() -> Printer:
    return Printer.read(HEIGHTS)


def figure_mm(words: str) -> float:
    """That of the page, behind these words."""
    text = " ".join(PAGE.read_text("utf-8").split())
    match = re.search(rf"{re.escape(words)} by ([\d.]+) mm", text)
    assert match, words
    return float(match[1])


def test_a_left_out_height_by_six_factors(printer: Printer) -> None:
    assert len(printer.contacts) == 10
    assert rms(printer.missed_mm(printer.uncalibrated)) == pytest.approx(
        figure_mm("uncalibrated firmware misses it"), abs=ROUNDED_MM
    )
    assert rms(printer.missed_mm(printer.six)) == pytest.approx(
        figure_mm("the six factors"), abs=ROUNDED_MM
    )


@LONG
def test_a_left_out_height_by_the_exported_file(printer: Printer) -> None:
    assert rms(printer.missed_mm(printer.ours)) == pytest.approx(
        figure_mm("glidecal with the tolerances of `import`"), abs=ROUNDED_MM
    )
    loose = partial(printer.ours, across_mm=LOOSE_MM)
    assert rms(printer.missed_mm(loose)) == pytest.approx(
        figure_mm("glidecal with `across_tolerance_mm = 4.0`"), abs=ROUNDED_MM
    )
