"""The two pages that are signed: who, what, with which result; everything else is in the annex."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from rich.table import Table

from app.report.certificate import CertificateHead, Certified, CertifiedCalibration
from app.report.charts.legs import LegFigure
from app.report.pages.figures import leg_sheet_svg
from app.report.text.caveats import taken_word
from app.report.text.correction import FRAME_WORDS, bound_table, correction_table
from app.report.text.printer import change_tables
from app.report.text.result import DECISION_RULE, decided, offsets_table, what_to_do
from app.report.text.tables import new_table
from calib.printable import printable

LONGEST, LONGEST_ENTRY, LONGEST_CELL = 220, 60, 28
"""Letters of a sentence, an entry and a narrow cell on these pages; the annex has the whole."""

MOST_RECORDS, MOST_INSTRUMENTS, MOST_LIMITS, MOST_WARNINGS = 2, 3, 3, 2
"""So many are on these pages; the annex has all."""

UNCERTAINTY = (
    "± U of a value to enter, and the bound of the tool error, are for 95 % of everything that may "
    "be true of the machine with these readings, not added up from sources. The budget in the "
    "annex is of other values, the parameters as the papers identify them."
)

SIMULATED = "SIMULATED: no machine was measured. These readings were computed by the program."

LONGEST_OF_POSTURES = 400
"""Letters of a sentence on a session of postures: seven motions of frames have room."""

MOST_LEGS = 12
"""Pictures of legs for which there is room."""


Fact = tuple[str, Iterable[str | None]]
"""A heading, and what is stated there."""


@dataclass(frozen=True)
class Picture:
    """A picture as SVG, with the sentence below it."""

    svg: str
    caption: str


@dataclass(frozen=True)
class Section:
    """A heading with what stands below it, in this order; what is empty is left out."""

    heading: str
    parts: Sequence[str | Table | Picture]


@dataclass(frozen=True)
class PrintedPage:
    """A document of sections; ``sentences`` are first, ``identification`` is on every sheet."""

    title: str
    identification: str
    sentences: Sequence[str]
    sections: Sequence[Section]


@dataclass(frozen=True)
class CalibrationReport(PrintedPage):
    """Two pages to sign, and the sections as their annex.

    ``decision`` is that against the tolerance, or that there is none. Without ``head`` nobody
    certifies it.
    """

    decision: str
    first_page: Sequence[Section]
    second_page: Sequence[Section]
    head: CertificateHead | None


def calibration_report(
    certified: Certified,
    machine: str,
    *,
    decision: str,
    sentences: Sequence[str],
    facts: Iterable[Fact],
    result: Sequence[str | Table],
    second_page: Sequence[Section],
    annex: Sequence[Section],
) -> CalibrationReport:
    """The report on a ``machine``, whichever kind it is, with ``facts`` on how it was measured.

    Its first page says what was calibrated for whom, how and with what, and the result.
    """
    lines = [certified.traceability]
    if certified.attached:
        lines.append(shortened(certified.attached, LONGEST_OF_POSTURES))
    return CalibrationReport(
        title=f"Calibration {'certificate' if certified.head else 'report'}: {machine}",
        identification=certified.identification,
        sentences=sentences,
        sections=annex,
        decision=decision,
        first_page=[
            Section(
                "",
                [_object(certified, machine, facts), SIMULATED if certified.simulated else ""],
            ),
            Section("Traceability", [*_instruments(certified), *lines]),
            Section("Result", result),
        ],
        second_page=second_page,
        head=certified.head,
    )


def _object(certified: Certified, name: str, facts: Iterable[Fact]) -> Table:
    """The machine, the customer, the sessions that were measured with further ``facts`` on them."""
    records = certified.records
    table = new_table("object", shortened(name), left_columns=2)
    for heading, values in (
        *_ordered_facts(certified.head, certified.serial_numbers),
        ("measured", dict.fromkeys(r.opened.day_words(r.readings) for r in records)),
        ("operator", dict.fromkeys(record.operator for record in records)),
        ("temperature", dict.fromkeys(celsius_words(r.temperature_c) for r in records)),
        ("procedure", dict.fromkeys(record.procedure for record in records)),
        *facts,
    ):
        table.add_row(heading, shortened(", ".join(filter(None, values))) or "not stated")
    for record in records[:MOST_RECORDS]:
        table.add_row("record", shortened(record.name))
        table.add_row("SHA-256 of its last line", record.digest)
    if len(records) > MOST_RECORDS:
        table.add_row("records", f"{len(records) - MOST_RECORDS} more in the annex")
    return table


def second_page(calibration: CertifiedCalibration, legs: Sequence[LegFigure]) -> list[Section]:
    """Whether the values were entered, what U covers, the pictures of legs, and what limits."""
    result = calibration.result
    heading = f"{taken_word(result).capitalize()}s"
    caption = (
        f"{heading} with the fit, in mm, and below each what the fit leaves, in µm. All have the "
        "same scales."
    )
    if len(legs) > MOST_LEGS:
        caption += f" {len(legs) - MOST_LEGS} more are in the annex."
    return [
        Section("Entered and verified", _verified(calibration)),
        Section("Uncertainty", [UNCERTAINTY]),
        Section(heading, [Picture(leg_sheet_svg(legs[:MOST_LEGS]), caption)] if legs else []),
        Section("Limits of this result", shortened_limits(calibration.limits)),
    ]


def _ordered_facts(head: CertificateHead | None, serial_numbers: Sequence[str]) -> list[Fact]:
    """Which machine it is, for whom and where, as the order of a certificate states it."""
    facts: list[Fact] = []
    if serial_numbers or head:
        facts.append(("serial number", serial_numbers[:1]))
    facts += [("serial number in the record", [number]) for number in serial_numbers[1:]]
    if head:
        order = head.order
        machine, customer = order.machine, order.customer
        facts += [
            ("manufacturer, model", (machine.manufacturer, machine.model)),
            ("customer", [customer.name]),
            ("address", customer.address),
            ("place of calibration", [order.place]),
            ("date of issue", [f"{order.issued}" if order.issued else ""]),
        ]
    return facts


def celsius_words(value_c: float | None) -> str:
    """A temperature; empty where it is not known."""
    return "" if value_c is None else f"{value_c:g} °C"


def _instruments(certified: Certified) -> Iterator[Table]:
    """The certificates of instruments."""
    instruments = certified.instruments
    if not instruments:
        return
    table = new_table(certified.gauge, "serial number", "certificate", "of", left_columns=4)
    for instrument in instruments[:MOST_INSTRUMENTS]:
        date = f"{instrument.certificate_date}" if instrument.certificate_date else ""
        serial, certificate = instrument.serial_number or "", instrument.certificate
        entries = (instrument.name, serial, certificate or "none stated")
        table.add_row(*(shortened(entry, LONGEST_CELL) for entry in entries), date)
    if len(instruments) > MOST_INSTRUMENTS:
        table.add_row(f"{len(instruments) - MOST_INSTRUMENTS} more in the annex", "", "", "")
    yield table


def result_parts(calibration: CertifiedCalibration) -> list[str | Table]:
    """What is entered, and what the tool is off by without it and with it."""
    result, entered = calibration.result, calibration.verification is not None
    correction, change = result.correction, result.printer_change
    text = f"The values leave least of the tool's error, {FRAME_WORDS[correction.frame]}."
    if change:
        values = change_tables(change)
    else:
        values = [correction_table(correction)]
        text = (
            f"True position of a joint = believed position + d_rho. {text} They, not the joints "
            "alone, are within ± U."
        )
    return [
        bound_table(correction.frame, correction.off_now, result.entered.off, entered=entered),
        DECISION_RULE,
        *values,
        text,
        *map(_short_sentence, calibration.warnings[:MOST_WARNINGS]),
    ]


def _verified(calibration: CertifiedCalibration) -> list[str | Table]:
    """What a later session says of the values that were entered."""
    if (verification := calibration.verification) is None:
        return [not_verified_words(calibration)]
    sentences = [decided(verification), *what_to_do(verification)]
    return [*map(_short_sentence, sentences), offsets_table(verification)]


def not_verified_words(certified: Certified) -> str:
    """The sentence of a document without a later session."""
    return (
        "No session after the values were entered belongs to this document. What the "
        f"{certified.moved} keeps with them is predicted from the readings, not measured."
    )


def machine_table(certified: Certified, facts: Mapping[str, str]) -> Table:
    """What was known of a machine before; tolerances of parts are standard deviations."""
    limit_mm = certified.tolerance_mm
    stated = "not stated" if limit_mm is None else f"{limit_mm:g} mm r.m.s."
    rows = {**facts, f"tolerance of the {certified.moved}": stated}
    return new_table("machine", certified.name, left_columns=2, rows=rows.items())


def shortened_limits(limits: Sequence[str], longest: int = LONGEST) -> list[str]:
    """The gravest, how many more are in the annex, and what holds for all results."""
    more_count = len(limits) - MOST_LIMITS
    return [
        *(shortened(text, longest) for text in limits[:MOST_LIMITS]),
        *([f"{more_count} more in the annex."] if more_count > 0 else []),
        "The results are of this machine as it was when it was measured.",
    ]


def shortened(text: str, longest: int = LONGEST_ENTRY) -> str:
    """A text of a stranger in one line for which there is room."""
    line = " ".join(printable(text).split())
    return line if len(line) <= longest else f"{line[:longest]} …"


def _short_sentence(text: str) -> str:
    return shortened(text, LONGEST)
