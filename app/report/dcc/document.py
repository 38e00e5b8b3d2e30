"""A digital calibration certificate, XML, of what was calibrated."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import resources

from jinja2 import Environment, StrictUndefined, Template

from app.report.certificate import CertificateHead, Certified
from app.version import version
from calib.errors import UsageError
from calib.printable import printable

COVERAGE_PROBABILITY = 0.95

UNITS = {
    "mm": r"\milli\metre",
    "1/mm": r"\milli\metre\tothe{-1}",
    "m/m": r"\one",
    "mrad": r"\milli\radian",
    "°": r"\degree",
    "°C": r"\degreecelsius",
}
"""As D-SI writes them."""


@dataclass(frozen=True)
class CertifiedValue:
    """A value in a unit of D-SI; ``words`` say what it is, if the name does not.

    Uncertainties are standard, and expanded for 95 %; None where nobody states them.
    """

    name: str
    value: float
    unit: str = UNITS["mm"]
    expanded: float | None = None
    standard: float | None = None
    words: str = field(default="", kw_only=True)

    @property
    def coverage_factor(self) -> float:
        """Expanded over standard uncertainty; of a mixture of models it may be any."""
        return (self.expanded or 0.0) / (self.standard or 1.0)

    @property
    def interval(self) -> tuple[float, float]:
        """Both ends of the 95 % interval."""
        half = self.expanded or 0.0
        return self.value - half, self.value + half


@dataclass(frozen=True)
class Result:
    """Quantities that belong together."""

    name: str
    words: str
    quantities: Sequence[CertifiedValue]


def check_head(head: CertificateHead | None) -> CertificateHead:
    """What the schema asks for is stated. Raises UsageError."""
    thing = "a certificate as XML"
    if head is None:
        missing = "no number, customer and laboratory"
        raise UsageError(thing, missing, "a report with --certificate FILE")
    if head.laboratory.country is None:
        raise UsageError(
            thing,
            "no country of the laboratory in the settings file",
            'country = "DE" in its table [laboratory], as ISO 3166-1 writes it',
        )
    return head


def certificate_xml(certified: Certified, results: Iterable[Result]) -> str:
    """The certificate, not signed. Raises as `check_head`."""
    head, records = check_head(certified.head), certified.records
    text = _template().render(
        certified=certified,
        results=list(results),
        decisions=[pair for pair in certified.decisions.items() if pair[1]],
        order=head.order,
        laboratory=head.laboratory,
        days=sorted(day for r in records for day in r.opened.measured_days(r.readings)),
        dated=all(record.opened.is_dated for record in records),
        procedures=dict.fromkeys(r.procedure or "table of readings" for r in records),
        temperatures=[
            CertifiedValue(f"temperature, {r.name}", r.temperature_c, UNITS["°C"])
            for r in records
            if r.temperature_c is not None
        ],
        tolerance=CertifiedValue("tolerance", certified.tolerance_mm or 0.0),
        probability=COVERAGE_PROBABILITY,
        program_version=version(),
    )
    return "".join(line for line in text.splitlines(keepends=True) if not line.isspace())


@cache
def _template() -> Template:
    environment = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_as_text,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["stated"] = _stated
    text = resources.files("app.report.dcc").joinpath("dcc.xml").read_text(encoding="utf-8")
    return environment.from_string(text)


def _as_text(value: object) -> object:
    """Texts in one line without hidden characters, numbers with all of their digits."""
    if type(value) is float:
        if not math.isfinite(value):
            raise ValueError("a value that is not finite")
        return repr(value)
    return " ".join(printable(value).split()) if type(value) is str else value


def _stated(parts: Iterable[str | None]) -> list[str]:
    """The parts of which something is left on one line: the schema allows no empty text."""
    lines = (" ".join(printable(part).split()) for part in parts if part)
    return [line for line in lines if line]
