"""Tables as files (CSV, XLSX, Parquet): as rows of texts, and new ones for other programs."""

from __future__ import annotations

import csv
import re
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from io import BytesIO, StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import ZipFile

from calib.errors import RecordError, extra
from calib.printable import printable
from protocols.documents import read_bytes

if TYPE_CHECKING:
    from pandas import DataFrame

Cell = str | float | None
"""A whole number is an int, a missing value None."""

FORMATS = ("csv", "xlsx", "parquet")

Texts = list[tuple[int, list[str]]]
"""Line numbers, and the cells as a spreadsheet shows them."""

MOST_UNPACKED_BYTES = 200_000_000
MOST_COLUMNS = 100
MOST_LETTERS = 32_767
"""In a cell of a workbook: more is cut off by who opens it."""

NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
FORMULA = re.compile(r"""["'\s]*[=+\-@]""")
"""A spreadsheet computes a cell that begins so, quotes left out."""

FORMULA_INSIDE = re.compile(rf"([,;]){FORMULA.pattern}")
"""A line of notes is not quoted, so a spreadsheet may find cells in it."""

SEMICOLON = re.compile(rf";(?={FORMULA.pattern})")
"""Where spreadsheets part cells by semicolons, a cell of commas is parted here, quoted or not."""

AMBIGUOUS = re.compile(r"\\(?=u003b|u005c)")
SHOWN = re.compile(r"\\u(003b|005c)")


@dataclass(frozen=True)
class DataTable:
    """Columns with names that carry their units, and rows ``(n, n_columns)`` in their order."""

    names: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]

    def to_frame(self) -> DataFrame:
        """For pandas. Raises UsageError where that is not installed."""
        with extra("to_frame()", "frames"):
            import pandas
        return pandas.DataFrame.from_records(list(self.rows), columns=list(self.names))

    def written(self, as_format: str) -> str | bytes:
        """The table as a file of one of `FORMATS`, its texts `protected`: they are read as here.

        Raises UsageError where the library for it is not installed.
        """
        if as_format == "csv":
            return csv_text(["" if c is None else str(c) for c in row] for row in self._lines)
        safe = [[protected(c) if isinstance(c, str) else c for c in row] for row in self._lines]
        if as_format == "xlsx":
            return workbook(safe, "export")
        arrow, parquet = _pyarrow("export")
        header, *rows = safe
        columns = zip(*rows, strict=True) if rows else ([] for _ in header)
        out = BytesIO()
        table = arrow.table(dict(zip(header, map(list, columns), strict=True)))
        parquet.write_table(table, out)
        return out.getvalue()

    @property
    def _lines(self) -> tuple[tuple[Cell, ...], ...]:
        return (self.names, *self.rows)


def csv_text(rows: Iterable[Sequence[str]], notes: Iterable[str] = ()) -> str:
    """Notes as one ``#`` line each, then the rows. No text is a formula in a spreadsheet."""
    out = StringIO()
    for note in notes:
        line = printable(" ".join(note.split()))
        out.write("# " + FORMULA_INSIDE.sub(lambda match: f"{match[1]} '{match[0][1:]}", line))
        out.write("\n")
    csv.writer(out, lineterminator="\n").writerows(map(protected, row) for row in rows)
    return out.getvalue()


def protected(text: str) -> str:
    """A text as a cell that nothing computes and nothing strips; `unprotected` is the way back.

    Apostrophes around what looks like a formula, begins or ends with a space, or has apostrophes
    there itself. Hidden characters are shown, for good.
    """
    safe = SEMICOLON.sub(r"\\u003b", AMBIGUOUS.sub(r"\\u005c", printable(text)))
    formula = FORMULA.match(safe) and not NUMBER.fullmatch(safe)
    return f"'{safe}'" if formula or safe != safe.strip() or _is_quoted(safe) else safe


def unprotected(cell: str) -> str:
    """The text that `protected` made this of; a cell that it could not have made, as it is."""
    inside = cell[1:-1] if _is_quoted(cell) else cell
    return SHOWN.sub(lambda match: ";" if match[1] == "003b" else "\\", inside)


def _is_quoted(text: str) -> bool:
    return len(text) > 1 and text[0] == text[-1] == "'"


def parquet_rows(path: Path, most_rows: int) -> Texts:
    """Line numbers and texts of a table of columns, its header first.

    Raises RecordError, and UsageError where pyarrow is not installed.
    """
    subject = f"table {path}"
    content = BytesIO(read_bytes(path, "table"))
    _, parquet = _pyarrow(subject)
    try:
        file = parquet.ParquetFile(content)
        size = sum(file.metadata.row_group(k).total_byte_size for k in range(file.num_row_groups))
        narrow = file.metadata.num_columns <= MOST_COLUMNS
        _check_size(narrow and file.metadata.num_rows <= most_rows and size <= MOST_UNPACKED_BYTES)
        table = file.read()
        columns = [list(map(_text, column.to_pylist())) for column in table.columns]
        rows = list(map(list, zip(*columns, strict=True)))
    except Exception as problem:  # a broken file meets the library in any of its parts
        raise RecordError(
            subject, next_step="Save the table again, or as CSV", reason="no readable Parquet file"
        ) from problem
    return list(enumerate([list(map(str, table.column_names)), *rows], start=1))


def _check_size(fits: bool) -> None:
    """Raises ValueError for what is small only while it is packed."""
    if not fits:
        raise ValueError("too large")


def _text(value: object) -> str:
    return "" if value is None or value != value else str(value)  # noqa: PLR0124 (NaN)


def _pyarrow(subject: str) -> tuple[Any, Any]:
    with extra(subject, "parquet"):
        import pyarrow
        from pyarrow import parquet
    return pyarrow, parquet


def workbook_rows(path: Path, most_rows: int) -> Texts:
    """Line numbers and texts of the first sheet, each row at least as long as the first one.

    Formulas give what they had when the file was saved. Raises RecordError, and UsageError where
    openpyxl is not installed.
    """
    subject = f"table {path}"
    content, openpyxl = BytesIO(read_bytes(path, "table")), _openpyxl(subject)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of styles and extensions that nobody needs
            with ZipFile(content) as parts:
                size = sum(part.file_size for part in parts.infolist())
            _check_size(size <= MOST_UNPACKED_BYTES)
            book = openpyxl.load_workbook(content, read_only=True, data_only=True)
            sheet = book.worksheets[0]
            cells = sheet.iter_rows(max_row=most_rows, max_col=MOST_COLUMNS, values_only=True)
            rows = list(map(_texts, cells))
    except Exception as problem:  # a broken workbook meets the library in any of its parts
        next_step = "Save the table again, or as CSV"
        raise RecordError(subject, next_step=next_step, reason="no readable workbook") from problem
    width = len(rows[0]) if rows else 0
    return [(line, row + [""] * (width - len(row))) for line, row in enumerate(rows, start=1)]


def _texts(row: Iterable[object]) -> list[str]:
    """The cells, numbers as a spreadsheet shows them; without the empty ones at the end."""
    cells = [f"{cell:.15g}" if isinstance(cell, float) else cell for cell in row]
    while cells and cells[-1] is None:
        cells.pop()
    return ["" if cell is None else str(cell) for cell in cells]


def workbook(rows: Iterable[Sequence[Cell]], subject: str) -> bytes:
    """A workbook with these rows; numbers of more digits than a spreadsheet has are texts.

    Raises UsageError where openpyxl is not installed, RecordError for a text longer than a cell.
    """
    book = _openpyxl(subject).Workbook()
    for row in rows:
        longest = max((len(cell) for cell in row if isinstance(cell, str)), default=0)
        if longest > MOST_LETTERS:
            value, requirement = f"a text of {longest} letters", f"{MOST_LETTERS} in a workbook"
            raise RecordError(subject, value, requirement)
        book.active.append(
            [repr(c) if isinstance(c, float) and float(f"{c:.15g}") != c else c for c in row]
        )
    out = BytesIO()
    book.save(out)
    return out.getvalue()


def _openpyxl(subject: str) -> Any:  # noqa: ANN401 (a module)
    with extra(subject, "xlsx", ", or save the table as CSV"):
        import openpyxl
    return openpyxl
