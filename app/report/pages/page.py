"""A report as one self-contained page: HTML, or PDF of the same."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import cache
from importlib import resources
from pathlib import Path

from jinja2 import Environment, StrictUndefined, Template
from markupsafe import Markup
from rich.console import RenderableType
from rich.table import Table

from app.report.pages.report import CalibrationReport, report_of
from calib.errors import UsageError
from calib.printable import printable
from protocols.files import write_files

PDF_NEEDS = (
    "the system's library Pango (Debian: libpangoft2-1.0-0); or write .html and print that "
    "from a browser"
)


def html_of(report: CalibrationReport) -> str:
    """One page without a script or anything from elsewhere; texts of strangers are inert."""
    return _template().render(report=report)


@cache
def _template() -> Template:
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, finalize=_shown, keep_trailing_newline=True
    )
    environment.filters |= {"svg": _drawing, "cells": _cells}
    text = resources.files("app.report.pages").joinpath("report.html").read_text(encoding="utf-8")
    return environment.from_string(text)


def _shown(value: object) -> object:
    """Hidden characters are shown, as everywhere."""
    return (
        printable(value, keep="\n")
        if isinstance(value, str) and not isinstance(value, Markup)
        else value
    )


def _cells(table: Table) -> list[tuple[RenderableType, ...]]:
    """Rows of a table."""
    return list(zip(*(column.cells for column in table.columns), strict=True))


def _drawing(svg: str) -> Markup:
    """The element alone; it is ours, and the texts in it are paths."""
    return Markup(svg[svg.index("<svg") :])


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


def write_report(
    sessions: Sequence[Path],
    output: Path,
    model: Path | None = None,
    after: Path | None = None,
    *,
    tolerance_mm: float | None = None,
    replace: bool = False,
) -> Path:
    """Write the report of session files to a path that ends with ``.html`` or ``.pdf``.

    Raises UsageError for another ending, and as `report_of` and `write_files`.
    """
    if output.suffix not in (".html", ".pdf"):
        raise UsageError("--output", f"{output}", "a path that ends with .html or .pdf")
    html = html_of(report_of(sessions, model=model, after=after, tolerance_mm=tolerance_mm))
    written = pdf_of(html) if output.suffix == ".pdf" else html
    return write_files(output, {"": written}, replace=replace)[0]
