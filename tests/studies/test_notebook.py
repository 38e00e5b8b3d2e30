"""The notebook of the papers runs and prints what is kept in it; mkdocs makes a page of it."""

from __future__ import annotations

import re

from studies.notebook import executed, read
from tests.conftest import LONG


def _printed() -> str:
    cells = [cell for cell in read()["cells"] if cell["cell_type"] == "code"]
    return "".join("".join(out["text"]) for cell in cells for out in cell["outputs"])


@LONG
def test_it_prints_what_is_kept() -> None:
    notebook = read()
    assert executed(notebook) == notebook, "make it again: python -m studies.notebook"


def test_it_gives_the_tables() -> None:
    """Pashkevich et al. 2008: tables 1 to 3 to 0.01 mm, but for three signs and the full set."""
    rows = [line.split() for line in _printed().splitlines()]
    computed, printed = (
        [row[1:] for row in rows if row[:1] == [kind]] for kind in ("left", "printed")
    )
    for name, numbers, printed_numbers in zip(
        ("1c", "2", "3"), computed[1:], printed[1:], strict=False
    ):
        pairs = zip(map(float, numbers), map(float, printed_numbers), strict=True)
        assert all(abs(a - b) < 0.0101 for a, b in pairs), name
    pairs_of_table_2 = re.findall(r"([+-]?\d\.\d{3}) \(([+-]\d\.\d\d)\)(!?)", _printed())
    assert len(pairs_of_table_2) == 36
    wrong = [(float(a), float(b)) for a, b, differs in pairs_of_table_2 if differs]
    assert len(wrong) == 3
    assert all(abs(a + b) < 0.01 for a, b in wrong), "only the sign"
    sets, of_paper = ([row[1:] for row in rows if row[:1] == [k]] for k in ("found", "printed"))
    for computed_set, printed_set in zip(sets[1:], of_paper[-2:], strict=True):
        pairs = zip(map(float, computed_set), map(float, printed_set), strict=True)
        assert all(abs(a - b) < 0.0101 for a, b in pairs)
