"""What a report and a certificate of a session of postures are made of."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from app.evaluating.hexaslide import PostureResult, posture_result
from app.evaluating.hexaslide_calibration import (
    CalibratedMachine,
    VerifiedMachine,
    decided,
    verify_sessions,
)
from app.evaluating.posture_history import Decision
from app.evaluating.tolerance import check_tolerance
from app.report.certificate import CertificateHead, CertifiedResults
from protocols.hexaslide_session import PostureSession, read_postures
from protocols.record import Record

if TYPE_CHECKING:  # of one document alone
    from app.report.dcc.document import CertificateContents
    from app.report.pages.contents import CalibrationReport


@dataclass(frozen=True, eq=False)
class VerifyingSession:
    """A later session, and what it says of the machine that was entered."""

    session: PostureSession
    record: Record
    verified: VerifiedMachine


@dataclass(frozen=True, eq=False)
class CertifiedPostures(CertifiedResults):
    """The results of a session, and of a ``later`` one with the calibrated machine entered."""

    result: PostureResult
    later: VerifyingSession | None = None

    def page(self) -> CalibrationReport:
        """The report of results that are there."""
        from app.report.pages.hexaslide import report_page  # its figures load matplotlib

        return report_page(self)

    def certificate(self) -> CertificateContents:
        """Raises as `check_head`."""
        from app.report.dcc.hexaslide import contents_of

        return contents_of(self)

    @property
    def solved(self) -> CalibratedMachine:
        """The machine that the session gives."""
        return self.result.solved

    @property
    def recorded_serial_number(self) -> str | None:
        """Of the machine, as the record states it."""
        return self.solved.source.machine.serial_number

    @property
    def decision(self) -> Decision | None:
        """On the platform as it was measured; None without a tolerance."""
        return None if self.tolerance_mm is None else decided(self.solved, self.tolerance_mm)

    @property
    def sessions(self) -> tuple[tuple[PostureSession, Record], ...]:
        """Both with their records, the later one last."""
        later = [(self.later.session, self.later.record)] if self.later else []
        return ((self.result.session, self.result.record), *later)

    @property
    def digests(self) -> tuple[str, ...]:
        """Of the records, in their order."""
        return tuple(record.digest for _, record in self.sessions)


def certified_postures(
    path: Path,
    after: Path | None = None,
    tolerance_mm: float | None = None,
    head: CertificateHead | None = None,
) -> CertifiedPostures:
    """Of a session and a later one, judged by the tolerance that is given, or else that of the
    machine file, the later one's where there is one.

    Raises as `posture_result` and `verify_sessions`.
    """
    check_tolerance(tolerance_mm)
    later = None
    if after is not None:
        verified = verify_sessions(path, after, tolerance_mm)
        later = VerifyingSession(*read_postures(after), verified)
        tolerance_mm = verified.tolerance_mm
    result = posture_result(path)
    if later is None:
        tolerance_mm = tolerance_mm or result.solved.source.machine.platform_tolerance_mm
    return CertifiedPostures(result, later, tolerance_mm=tolerance_mm, head=head)
