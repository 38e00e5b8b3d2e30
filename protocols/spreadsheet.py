"""Tables as workbooks (XLSX): the first sheet as rows of texts, and rows as a new workbook."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZipFile

from calib.errors import RecordError, extra
from protocols.documents import read_bytes

SUFFIX = ".xlsx"
MOST_UNPACKED_BYTES = 200_000_000
MOST_COLUMNS = 100
MOST_LETTERS = 32_767


def read_rows(path: Path, most_rows: int) -> list[tuple[int, list[str]]]:
    """Line number and cells of the first sheet's rows, each at least as long as the first one.

    Formulas give what they had when the file was saved. Raises RecordError, and UsageError where
    openpyxl is not installed.
    """
    thing = f"table {path}"
    content, openpyxl = BytesIO(read_bytes(path, "table")), _openpyxl(thing)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of styles and extensions that nobody needs
            _check_unpacked(content)
            book = openpyxl.load_workbook(content, read_only=True, data_only=True)
            sheet = book.worksheets[0]
            found = sheet.iter_rows(max_row=most_rows, max_col=MOST_COLUMNS, values_only=True)
            rows = list(map(_texts, found))
    except Exception as problem:  # a broken workbook meets the library in any of its parts
        next_step = "Save the table anew, or as CSV"
        raise RecordError(thing, next_step=next_step, reason="no readable workbook") from problem
    width = len(rows[0]) if rows else 0
    return [(line, row + [""] * (width - len(row))) for line, row in enumerate(rows, start=1)]


def _check_unpacked(content: BytesIO) -> None:
    """Raises ValueError for what is small only while it is packed."""
    with ZipFile(content) as parts:
        if sum(part.file_size for part in parts.infolist()) > MOST_UNPACKED_BYTES:
            raise ValueError("too large")


def workbook(rows: Iterable[Sequence[str | float | None]], thing: str) -> bytes:
    """A workbook with these rows; numbers of more digits than a spreadsheet has are texts.

    Raises UsageError where openpyxl is not installed, RecordError for a text longer than a cell.
    """
    book = _openpyxl(thing).Workbook()
    for row in rows:
        if longest := max((len(cell) for cell in row if isinstance(cell, str)), default=0):
            _check_length(thing, longest)
        book.active.append([_as_shown(cell) for cell in row])
    out = BytesIO()
    book.save(out)
    return out.getvalue()


def _as_shown(cell: str | float | None) -> str | float | None:
    same = not isinstance(cell, float) or float(f"{cell:.15g}") == cell
    return cell if same else repr(cell)


def _check_length(thing: str, longest: int) -> None:
    if longest > MOST_LETTERS:
        raise RecordError(thing, f"a text of {longest} letters", f"{MOST_LETTERS} in a workbook")


def _openpyxl(thing: str) -> Any:  # noqa: ANN401 (a module)
    with extra(thing, "xlsx", ", or save the table as CSV"):
        import openpyxl
    return openpyxl


def _texts(row: Iterable[object]) -> list[str]:
    """The cells, numbers as a spreadsheet shows them; without the empty ones at the end."""
    cells = [f"{cell:.15g}" if isinstance(cell, float) else cell for cell in row]
    while cells and cells[-1] is None:
        cells.pop()
    return ["" if cell is None else str(cell) for cell in cells]
