"""The report as a page of its own, HTML or PDF, in which texts of strangers are inert."""

from __future__ import annotations

import os
from base64 import b64encode
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

from jinja2 import Environment, PackageLoader, StrictUndefined
from rich.console import RenderableType
from rich.table import Column, Table

from app.evaluating.comparison import reported_pair
from app.report.certificate import CertificateHead, Certified, calibration_of, issue_number
from app.report.dcc.document import Result, certificate_xml, check_head
from app.report.dcc.legs import results_of
from app.report.pages.contents import report_from
from app.report.pages.two_pages import CalibrationReport, PrintedPage, shortened
from app.version import program
from calib.errors import UsageError
from calib.printable import printable
from protocols.files import check_targets, write_files

if TYPE_CHECKING:  # of the extra sign
    from app.report.dcc.signature import SigningKey

ENDINGS = (".html", ".pdf", ".xml")

PDF_NEEDS = (
    "the system's library Pango (Debian: libpangoft2-1.0-0); or write .html and print that "
    "from a browser"
)

ONE_PIECE = 16
"""A table of at most so many rows is not cut by the end of a page."""

WIDTH_EM, LETTER_EM, GAP_EM = 60.0, 0.64, 1.4
"""Of a table at most, of a letter, and what keeps columns apart."""

LEAST_EM = 8.0
"""Of a column of texts, however many numbers stand beside them."""

HEADING_LETTERS, BOLD = 14, 1.15
"""A longer heading takes two lines; a bold letter is so much wider."""


def html_of(page: PrintedPage) -> str:
    """One page without a script or anything from elsewhere; texts of strangers are inert."""
    name = "report.html" if isinstance(page, CalibrationReport) else "history.html"
    return _environment().get_template(name).render(page=page)


@cache
def _environment() -> Environment:
    environment = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_printable,
        keep_trailing_newline=True,
        loader=PackageLoader("app.report", "pages"),
    )
    environment.globals |= {"one_piece": ONE_PIECE, "width_em": WIDTH_EM, "program": program()}
    environment.filters |= {
        "css": _css,
        "data": _data,
        "shortened": shortened,
        "svg": lambda text: _data(text.encode(), "image/svg+xml"),
        "columns": _columns,
        "rows": _rows,
        "kind": _kind,
        "widths": widths_em,
    }
    return environment


def _printable(value: object) -> object:
    """Hidden characters are shown, as everywhere."""
    return printable(value, keep="\n") if type(value) is str else value


def _columns(table: Table) -> list[Column]:
    """Columns in which something stands."""
    return [column for column in table.columns if any(column.cells) or not table.rows]


def _kind(column: Column) -> str:
    """Numbers stand to the right; what has no heading is a remark."""
    return "number" if column.justify == "right" and column.header else "text"


def widths_em(columns: Sequence[Column]) -> list[float]:
    """Widths in em, from the letters in each: numbers have theirs, texts share what is left of a
    page.

    Whoever shows the page then measures no cell, and one word of 300 letters squeezes no column.
    """
    widths = [GAP_EM + LETTER_EM * _letters(column) for column in columns]
    texts = [k for k, column in enumerate(columns) if _kind(column) == "text"]
    numbers = sum(widths) - sum(widths[k] for k in texts)
    remaining = max(WIDTH_EM - numbers, LEAST_EM * len(texts))
    for number, k in enumerate(sorted(texts, key=widths.__getitem__)):
        widths[k] = min(widths[k], remaining / (len(texts) - number))
        remaining -= widths[k]
    return widths


def _letters(column: Column) -> float:
    """Letters of the longest line; those of a heading are bold."""
    heading = str(column.header)
    half = max(map(len, (*heading.split(), heading[: len(heading) // 2 + 2])))
    above = len(heading) if len(heading) <= HEADING_LETTERS else half
    lines = (line for cell in column.cells for line in str(cell).split("\n"))
    return max(BOLD * above, *map(len, lines), 0)


def _rows(columns: Sequence[Column]) -> list[tuple[RenderableType, ...]]:
    return list(zip(*(column.cells for column in columns), strict=True))


def _data(content: bytes, kind: str) -> str:
    """The picture inside the address of an image: nothing in it can run or load anything."""
    return f"data:{kind};base64,{b64encode(content).decode()}"


def _css(text: str) -> str:
    """What stands between quotation marks in a style: letters and digits, all else by its number.

    A page box takes no text of the page itself in Chromium, and no text can end the style so.
    """
    characters = printable(text)
    return "".join(c if c.isascii() and c.isalnum() else f"\\{ord(c):06x}" for c in characters)


def pdf_of(html: str) -> bytes:
    """The page printed. Raises UsageError where the library cannot be loaded."""
    # fontTools writes the time into the fonts that it cuts down, unless this tells it one
    os.environ.setdefault("SOURCE_DATE_EPOCH", "0")
    try:
        from weasyprint import HTML
    except OSError as problem:  # not ImportError: it looks for the library as it is imported
        raise UsageError("a report as PDF", "no library to print it", PDF_NEEDS) from problem
    printed: bytes = HTML(string=html).write_pdf()
    return printed


@dataclass(frozen=True)
class ReportSource:
    """Results of records, as a page and as those of a digital certificate."""

    certified: Certified
    page: Callable[[], CalibrationReport]
    results: Callable[[], Iterable[Result]]


def source_of_legs(
    sessions: Sequence[Path],
    *,
    model: Path | None = None,
    later_path: Path | None = None,
    tolerance_mm: float | None = None,
    head: CertificateHead | None = None,
) -> ReportSource:
    """The report of sessions of a machine with three drives; a single one as `reported_pair` has
    it.

    Raises as `calibration_of`.
    """
    if len(sessions) == 1 and later_path is None:
        first, later_path = reported_pair(sessions[0])
        sessions = [first]
    calibration = calibration_of(
        sessions, model=model, later_path=later_path, tolerance_mm=tolerance_mm, head=head
    )
    return ReportSource(
        calibration, partial(report_from, calibration), partial(results_of, calibration)
    )


def write_report(
    source: Callable[[], ReportSource],
    output: Path,
    head: CertificateHead | None = None,
    key: SigningKey | None = None,
    *,
    replace: bool = False,
) -> Path:
    """Write a report to a path that ends with ``.html``, ``.pdf`` or ``.xml``.

    With ``head`` it is a certificate; XML is a digital one, signed with ``key`` where there is one.
    Raises UsageError for another ending, and as ``source``, `issue_number`, `check_head` and
    `write_files`.
    """
    if output.suffix not in ENDINGS:
        raise UsageError("--output", f"{output}", f"a path that ends with {', '.join(ENDINGS)}")
    check_targets([output], replace=replace)  # before long work
    digital = output.suffix == ".xml"
    if digital:
        check_head(head)
    report = source()
    certified = report.certified
    issue_number(head, certified.digests, certified.terms)
    content: str | bytes
    if not digital:
        html = html_of(report.page())
        content = pdf_of(html) if output.suffix == ".pdf" else html
    else:
        content = certificate_xml(certified, report.results())
        if key:
            from app.report.dcc.signature import signed

            content = signed(content, key)
    return write_files(output, {"": content}, replace=replace)[0]
