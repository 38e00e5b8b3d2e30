"""What a report and a certificate are made of: the results of sessions, and who states them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Literal

from pydantic import Field

from app.evaluating.comparison import Verification, verify_files
from app.evaluating.diagnosis import SessionDiagnosis, diagnose_sessions
from app.evaluating.loading import records_in_order
from app.evaluating.solution import Judgement, SessionSolution, judge, solve_files
from app.report.text.caveats import caveats, caveats_of_view, gauge_word
from app.report.text.correction import doubt_lines, warning_lines
from app.report.text.printer import change_answers
from app.report.text.result import decided, judged_sentence
from app.settings import WHAT, data_path, read_settings, settings_path
from calib.errors import RecordError, UsageError
from calib.identify.accuracy import Decision
from protocols.certificate import CertificateOrder, InstrumentIdentity, Laboratory, read_order
from protocols.documents import MOST_BYTES, Document, Name, read_bytes, read_remembered
from protocols.effect_entries import EffectEntry
from protocols.files import write_files
from protocols.machine import Machine
from protocols.model_file import read_model_file
from protocols.session import Beginning, Line, Session

MOST_LOGO_BYTES, MOST_LOGO_PIXELS = 1_000_000, 20_000_000
DIGEST_LETTERS = 12
"""Of the record's digest where a report has no number: enough to keep its pages together."""


NOT_JUDGED = (
    "NOT JUDGED: no tolerance was given (--tolerance), nor does the machine file state one ({})."
)
"""With the key of the machine file."""


@dataclass(frozen=True)
class Logo:
    """A picture as it stands in a file."""

    kind: Literal["image/png", "image/jpeg"]
    content: bytes


@dataclass(frozen=True)
class CertificateHead:
    """Who issues a certificate, and what a person states of it."""

    order: CertificateOrder
    laboratory: Laboratory
    logo: Logo | None


@dataclass(frozen=True, eq=False)
class CertifiedRecord:
    """A record that results are from: how it began, the readings that count, its digest.

    ``procedure`` is None of a table of readings.
    """

    name: str
    digest: str
    opened: Beginning
    readings: Sequence[Line]
    operator: str
    temperature_c: float | None
    procedure: str | None


@dataclass(frozen=True, eq=False, kw_only=True)
class Certified:
    """What report and certificate state of a machine, whichever kind it is.

    ``name`` and ``serial_number`` are those of the machine file. The last record is that of a later
    session. ``gauge`` is the word for what measured, ``attached`` a sentence on what the operator
    attached. ``moved``, the tool or the platform, has the tolerance; ``decisions`` are by what was
    judged, None where it was not; all depends on the ``terms`` beside the records. ``warnings``
    must be known before values are entered, ``limits`` before numbers are used, the gravest first.
    Without ``head`` nobody certifies it.
    """

    head: CertificateHead | None
    name: str
    serial_number: str | None
    records: tuple[CertifiedRecord, ...]
    gauge: str
    instruments: tuple[InstrumentIdentity, ...]
    attached: str = ""
    completeness: str
    warnings: list[str]
    limits: list[str]
    moved: Literal["tool", "platform"]
    tolerance_mm: float | None
    decisions: Mapping[str, Decision | None]
    terms: str

    @property
    def simulated(self) -> bool:
        """Whether any of the records was computed."""
        return any(record.opened.origin == "simulated" for record in self.records)

    @property
    def serial_numbers(self) -> tuple[str, ...]:
        """Serial numbers of the machine: the order's, and the record's where that is another."""
        ordered = self.head.order.machine.serial_number if self.head else None
        return tuple(dict.fromkeys(filter(None, (ordered, self.serial_number))))

    @property
    def digests(self) -> tuple[str, ...]:
        """Digests of the records, in their order."""
        return tuple(record.digest for record in self.records)

    @property
    def identification(self) -> str:
        """What stands on every page: the number, or the beginning of the last record's digest."""
        if self.head:
            return f"Certificate {self.head.order.number}"
        return f"Record {self.digests[-1][:DIGEST_LETTERS]}"

    @property
    def traceability(self) -> str:
        """Whether lengths are traceable; without a certificate of every gauge they are not."""
        if not self.instruments:
            return f"No {self.gauge} is named, so no traceability to the SI is shown."
        if all(instrument.certificate for instrument in self.instruments):
            certificates = f"these certificates of the {self.gauge}s"
            return f"Lengths are traceable to the SI through {certificates}."
        return f"Traceability to the SI is not shown: not every {self.gauge} has a certificate."


@dataclass(frozen=True, eq=False, kw_only=True)
class CertifiedCalibration(Certified):
    """The results of sessions, and of a later one with the values entered.

    ``effects`` are those of the model file, which were fitted, too; ``judged`` is the decision on
    the tool now and with the values entered, None without a tolerance.
    """

    machine: Machine
    result: SessionSolution
    diagnosed: SessionDiagnosis
    verification: Verification | None
    judged: Judgement | None
    effects: tuple[EffectEntry, ...]

    @property
    def solutions(self) -> tuple[SessionSolution, ...]:
        """Solution of the sessions, and that of the later one."""
        return (self.result, *([self.verification.compared.after] if self.verification else []))

    @property
    def sessions(self) -> tuple[Session, ...]:
        """All of them, the later one last."""
        return tuple(session for solution in self.solutions for session in solution.sessions)

    @property
    def counted(self) -> dict[str, int]:
        """How many readings of each session count, by its digest."""
        missing_counts = {
            id(reading)  # sessions of one name may stand in two folders
            for solution in self.solutions
            for alone in solution.isolated
            for reading in alone.readings
        }
        return {
            session.digest: sum(id(reading) not in missing_counts for reading in session.readings)
            for session in self.sessions
        }

    @property
    def judged_words(self) -> str:
        """The decision before the values were entered, or that there is none."""
        if self.judged is None:
            return NOT_JUDGED.format("tool_tolerance_mm")
        return judged_sentence(self.judged, verified=False, entered=self.verification is not None)

    @property
    def decision(self) -> str:
        """The decision that heads the report: after a verification that of the later session."""
        return decided(self.verification) if self.verification else self.judged_words


def terms_of(tolerance_mm: float | None) -> str:
    """What results and decision of a certificate depend on beside its records."""
    return "no tolerance" if tolerance_mm is None else f"tolerance {tolerance_mm:g} mm"


def calibration_of(
    paths: Sequence[Path],
    *,
    model: Path | None = None,
    later_path: Path | None = None,
    tolerance_mm: float | None = None,
    head: CertificateHead | None = None,
) -> CertifiedCalibration:
    """The results of sessions, with what a later one says of the offsets of the last.

    Raises as `solve_files`, `diagnose_sessions` and `verify_files`.
    """
    result = solve_files(paths, model=model)
    diagnosed = diagnose_sessions(
        result.sessions, model=model, catalogue_corrections=result.corrections
    )
    last = records_in_order(paths)[-1].path
    verified = verify_files(last, later_path, tolerance_mm, result=result) if later_path else None
    if verified:  # one tolerance for all decisions
        tolerance_mm = verified.tolerance_mm
    elif tolerance_mm is None:
        tolerance_mm = result.sessions[-1].opened.machine.tool_tolerance_mm
    sessions = (*result.sessions, *(verified.compared.after.sessions if verified else ()))
    judged = None if tolerance_mm is None else judge(result, tolerance_mm)
    effects, terms = read_model_file(model).effects if model else (), terms_of(tolerance_mm)
    if model:
        content = read_bytes(model, "model file", MOST_BYTES)
        terms += f", model {sha256(content).hexdigest()[:DIGEST_LETTERS]}"
    diagnosis, machine = diagnosed.diagnosis, sessions[0].opened.machine
    change = result.printer_change
    return CertifiedCalibration(
        head=head,
        name=machine.name,
        serial_number=machine.serial_number,
        machine=machine,
        records=tuple(
            CertifiedRecord(
                *(session.name, session.digest, opened, session.readings),
                *(opened.operator, opened.temperature_c),
                opened.procedure.name if opened.procedure else None,
            )
            for session in sessions
            for opened in [session.opened]
        ),
        gauge=gauge_word(result),
        instruments=_instruments(sessions, head),
        completeness=f"{diagnosis.verdict}: {diagnosis.sentence}",
        warnings=[*doubt_lines(result), *change_answers(result, change)]
        if change
        else [*warning_lines(result, result.correction)],
        limits=_limits(result, diagnosed, effects),
        moved="tool",
        tolerance_mm=tolerance_mm,
        decisions={
            "tool as measured": judged.before if judged else None,
            "tool with the values entered, predicted": judged.after if judged else None,
            "tool measured again with the values entered": verified.decision if verified else None,
        },
        terms=terms,
        result=result,
        diagnosed=diagnosed,
        verification=verified,
        judged=judged,
        effects=effects,
    )


def _instruments(
    sessions: Sequence[Session], head: CertificateHead | None
) -> tuple[InstrumentIdentity, ...]:
    """Each indicator once, whatever axes it measured along, then those of the order.

    A table and a log do not name theirs: those of the order are in their place.
    """
    ordered = head.order.instrument if head else ()
    recorded = (
        InstrumentIdentity.model_construct(  # a record may hold what an order may not
            name=indicator.profile,
            serial_number=indicator.serial_number,
            certificate=indicator.certificate,
            certificate_date=indicator.certificate_date,
        )
        for session in sessions
        for indicator in session.opened.instruments
        if not (ordered and session.opened.origin == "imported")
    )
    return tuple(dict.fromkeys((*recorded, *ordered)))


def _limits(
    result: SessionSolution, diagnosed: SessionDiagnosis, effects: Sequence[EffectEntry]
) -> list[str]:
    added = ", ".join(f"{effect.id} ({effect.where})" for effect in effects)
    return [
        *([f"All figures are with what the model file adds: {added}."] if added else []),
        *result.warnings,
        *diagnosed.warnings,
        *caveats(result),
        *caveats_of_view(result),
        *(f"Remark: {remark}" for remark in diagnosed.diagnosis.remarks),
    ]


class IssuedNumbers(Document):
    """Numbers of certificates that this computer wrote.

    With the digests of their records, and the terms behind them: older ones have none.
    """

    numbers: dict[Name, tuple[str, ...]] = Field(default_factory=dict)


def issue_number(head: CertificateHead | None, digests: tuple[str, ...], terms: str) -> None:
    """Remember the number of a certificate.

    The same records on the same ``terms`` may have it in every format. Raises UsageError for the
    number of others, and as `read_remembered` and `write_files`.
    """
    if head is None:
        return
    path = data_path().with_name("certificates.json")
    numbers = read_remembered(path, IssuedNumbers, "numbers of certificates,").numbers
    number, identity = head.order.number, (*digests, terms)
    if numbers.get(number, identity) not in (identity, digests):
        issued_as = numbers[number]
        if issued_as[:-1] == digests:
            raise UsageError(
                f"certificate {number}",
                f"{terms} in place of {issued_as[-1]}",
                "the tolerance and the model that this certificate has",
                "Another decision is another certificate: give it a number of its own.",
            )
        records = ", ".join(part[:DIGEST_LETTERS] for part in issued_as if " " not in part)
        raise UsageError(
            f"certificate {number}",
            "a number that another certificate has",
            "a number of its own, or the sessions and --after of that certificate",
            f"The digests of its records begin with {records}; {path} lists all numbers.",
        )
    if numbers.get(number) != identity:
        issued = IssuedNumbers(numbers={**numbers, number: identity})
        write_files(path, {"": issued.model_dump_json(indent=1)}, replace=True)


def read_head(order: Path) -> CertificateHead:
    """The order of a certificate with the laboratory of the settings file.

    Raises RecordError for a file that cannot be used, UsageError where there is no laboratory.
    """
    certificate_order, path = read_order(order), settings_path()
    laboratory = read_settings(path).laboratory
    if laboratory is None:
        raise UsageError(
            f"certificate {certificate_order.number}",
            f"no laboratory in the settings file {path}",
            'a table [laboratory] there, with name = "…"',
        )
    logo = None if laboratory.logo is None else read_logo(path.parent / laboratory.logo)
    return CertificateHead(certificate_order, laboratory, logo)


def read_logo(path: Path) -> Logo:
    """A picture for the head. Raises RecordError where it is none, or too large."""
    from PIL import Image  # comes with matplotlib: with the extra report alone

    content = read_bytes(path, "logo", MOST_LOGO_BYTES)
    reason = "no picture that can be read"
    try:
        with Image.open(BytesIO(content), formats=("PNG", "JPEG")) as picture:
            if picture.width * picture.height <= MOST_LOGO_PIXELS:
                picture.load()
                return Logo("image/png" if picture.format == "PNG" else "image/jpeg", content)
            reason = f"{picture.width} times {picture.height} pixels"
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError):
        pass
    raise RecordError(
        f"logo {path} of the {WHAT}",
        reason=reason,
        allowed=f"a PNG or JPEG file up to {MOST_LOGO_BYTES:,} bytes and {MOST_LOGO_PIXELS:,} "
        "pixels",
    )
