"""Tables as files (CSV, XLSX, Parquet): as rows of texts, and new ones for other programs."""

from __future__ import annotations

import csv
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from io import BytesIO, StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeVar
from zipfile import ZipFile

from calib.errors import RecordError, extra
from calib.printable import printable
from calib.quantity import Quantity, quantities
from protocols.documents import read_bytes, read_text

if TYPE_CHECKING:
    from pandas import DataFrame

R = TypeVar("R")

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
COMMA = re.compile(r"[+-]?\d*,\d+", re.ASCII)
WORKBOOK, PARQUET = ".xlsx", ".parquet"
SEPARATORS = ",;"
SEPARATOR_LINE = re.compile(r'"?sep=([^\n])"?[;,\t ]*(?:\n|$)', re.IGNORECASE)
"""The first line by which Excel tells itself what stands between the cells."""

FORMULA = re.compile(r"""["'\s]*[=+\-@]""")
"""A spreadsheet computes a cell that begins so, quotes left out."""

FORMULA_INSIDE = re.compile(rf"([,;]){FORMULA.pattern}")
"""A line of notes is not quoted, so a spreadsheet may find cells in it."""

SEMICOLON = re.compile(rf";(?={FORMULA.pattern})")
"""Where spreadsheets part cells by semicolons, a cell of commas is parted here, quoted or not."""

AMBIGUOUS = re.compile(r"\\(?=u003b|u005c)")
ESCAPE = re.compile(r"\\u(003b|005c)")


@dataclass(frozen=True)
class DataTable:
    """Columns with names that carry their units, and rows ``(n, n_columns)`` in their order.

    ``quantities`` say what each column is to a reader.
    """

    names: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    quantities: tuple[Quantity, ...]

    @classmethod
    def plain(cls, names: Sequence[str], rows: Iterable[tuple[Cell, ...]]) -> Self:
        """Columns of which a reader knows no more than their names."""
        return cls((*names,), (*rows,), tuple(map(Quantity, names)))

    @classmethod
    def of(cls, kind: type[R], rows: Iterable[R] | Mapping[str, R], key: str = "") -> Self:
        """A column for each field of a data class; rows of a mapping have a first one, ``key``."""
        columns = quantities(kind)
        names = tuple(quantity.column(name) for name, quantity in columns.items())
        if isinstance(rows, Mapping):
            cells = tuple((name, *_cells(row, columns)) for name, row in rows.items())
            return cls((key, *names), cells, (Quantity(key), *columns.values()))
        return cls(names, tuple(_cells(row, columns) for row in rows), (*columns.values(),))

    @property
    def headings(self) -> tuple[str, ...]:
        """Headings of the columns for a reader."""
        return tuple(self.quantities[k].heading for k in self._for_reader)

    @property
    def text_columns(self) -> int:
        """How many columns for a reader are texts, before the first number."""
        cells = [row[k] for row in self.rows[:1] for k in self._for_reader]
        return next((k for k, cell in enumerate(cells) if not isinstance(cell, str)), len(cells))

    def reader_rows(self) -> Iterator[tuple[str, ...]]:
        """Cells as texts for a reader, values with the decimals that their uncertainty needs."""
        widths = [k for k, column in enumerate(self.quantities) if column.kind == "uncertainty"]
        for row in self.rows:
            least = min((cell for k in widths if isinstance(cell := row[k], float)), default=None)
            yield tuple(self.quantities[k].shown(row[k], least) for k in self._for_reader)

    @property
    def _for_reader(self) -> list[int]:
        return [k for k, column in enumerate(self.quantities) if column.label is not None]

    def _repr_html_(self) -> str:
        """The table in Jupyter: the columns for a reader, with the help of each over it."""
        columns = [self.quantities[k] for k in self._for_reader]
        head = (f'<th title="{escape(q.words)}">{escape(q.heading)}</th>' for q in columns)
        rows = ((f"<td>{escape(cell)}</td>" for cell in row) for row in self.reader_rows())
        lines = ("".join(row) for row in (head, *rows))
        return f"<table>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>"

    def to_frame(self) -> DataFrame:
        """The table for pandas. Raises UsageError where that is not installed."""
        with extra("to_frame()", "frames"):
            import pandas
        return pandas.DataFrame.from_records(list(self.rows), columns=list(self.names))

    def file_content(self, as_format: str) -> str | bytes:
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


class Tabled:
    """A result that is a table, too."""

    def table(self) -> DataTable:
        """The table of its rows."""
        raise NotImplementedError

    def to_frame(self) -> DataFrame:
        """`table` for pandas. Raises UsageError where that is not installed."""
        return self.table().to_frame()

    def _repr_html_(self) -> str:
        return self.table()._repr_html_()


def _cells(row: object, columns: Iterable[str]) -> tuple[Cell, ...]:
    return tuple(_cell(getattr(row, name)) for name in columns)


def _cell(value: object) -> Cell:
    """A value that a spreadsheet can hold; several in one cell with commas between."""
    if value is None or isinstance(value, str | float | int):
        return value
    parts = value if isinstance(value, tuple) else (value,)
    return ", ".join(f"{part:g}" if isinstance(part, float) else f"{part}" for part in parts)


def check_separators(subject: str, header: Sequence[str]) -> None:
    """Raises RecordError where tabs stand between the columns, which no message would show."""
    if any("\t" in name for name in header):
        raise RecordError(
            subject,
            "tabs between columns",
            "commas, or semicolons beside decimal commas",
            "Save it again as CSV; editors and spreadsheets offer that where they save.",
        )


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
    return ESCAPE.sub(lambda match: ";" if match[1] == "003b" else "\\", inside)


def _is_quoted(text: str) -> bool:
    return len(text) > 1 and text[0] == text[-1] == "'"


def lines_of(path: Path, most_rows: int) -> tuple[Texts, bool]:
    """Line numbers and fields; whether semicolons stand between them, as with decimal commas.

    Raises RecordError.
    """
    if path.suffix.lower() == WORKBOOK:
        return workbook_rows(path, most_rows), False
    if path.suffix.lower() == PARQUET:
        return parquet_rows(path, most_rows - 1), False
    text = read_text(path, "table")
    separator_line = SEPARATOR_LINE.match(text)
    if separator_line and separator_line[1] not in SEPARATORS:
        requirement = "sep=; or sep=, as spreadsheets write it"
        raise RecordError(
            f"table {path}, line 1", repr(separator_line[0].rstrip("\n")), requirement
        )
    header = next((line for line in text.splitlines() if not line.startswith("#")), "")
    separator = (
        separator_line[1] if separator_line else SEPARATORS[";" in header and "," not in header]
    )
    lines = csv.reader(StringIO(text, newline=""), strict=True, delimiter=separator)
    try:
        rows = [(lines.line_num, values) for values in lines][bool(separator_line) :]
        width = len(_without_end(rows[0][1], 0)) if rows else 0
        return [(line, _without_end(values, width)) for line, values in rows], separator == ";"
    except csv.Error as problem:
        raise RecordError(
            f"table {path}, line {lines.line_num}", str(problem), "comma separated values"
        ) from problem


def _without_end(cells: list[str], width: int) -> list[str]:
    """The cells up to this width; beyond it without empty ones at the end.

    Spreadsheets write these where a cell beside the table was once in use.
    """
    while len(cells) > width and not cells[-1].strip():
        cells = cells[:-1]
    return cells


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
