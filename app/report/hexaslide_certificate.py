"""What a report and a certificate of a session of postures are made of."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from app.evaluating.hexaslide import PostureResult, posture_result
from app.evaluating.hexaslide_calibration import (
    CalibratedMachine,
    VerifiedMachine,
    decided,
    verify_sessions,
)
from app.evaluating.posture_history import Decision
from app.evaluating.tolerance import check_tolerance
from app.report.certificate import (
    CertificateHead,
    identification_of,
    serial_numbers_of,
    terms_of,
)
from app.report.schema.hexaslide import HexaSlideCalibrationReport
from app.report.text.hexaslide_calibration import caveats
from app.report.text.hexaslide_session import remark_lines
from protocols.hexaslide_session import PostureSession, read_postures
from protocols.record import Record


@dataclass(frozen=True, eq=False)
class VerifyingSession:
    """A later session, and what it says of the machine that was entered."""

    session: PostureSession
    record: Record
    verification: VerifiedMachine


@dataclass(frozen=True, eq=False)
class CertifiedPostures:
    """The results of a session, and of a ``later`` one with the calibrated machine entered.

    ``stated_mm`` is the tolerance that was given. Without ``head`` nobody certifies it.
    """

    result: PostureResult
    later: VerifyingSession | None = None
    stated_mm: float | None = None
    head: CertificateHead | None = None

    @property
    def calibration(self) -> CalibratedMachine:
        """The machine that the session gives."""
        return self.result.calibration

    @property
    def tolerance_mm(self) -> float | None:
        """Tolerance of the platform: that of the verification, else as given, else of the machine
        file.
        """
        if self.later is not None:
            return self.later.verification.tolerance_mm
        return self.stated_mm or self.calibration.source.machine.platform_tolerance_mm

    @property
    def decision(self) -> Decision | None:
        """Decision on the platform as it was measured; None without a tolerance."""
        return None if self.tolerance_mm is None else decided(self.calibration, self.tolerance_mm)

    @property
    def serial_numbers(self) -> tuple[str, ...]:
        """Serial numbers as of `serial_numbers_of`."""
        return serial_numbers_of(self.head, self.calibration.source.machine.serial_number)

    @property
    def sessions(self) -> tuple[tuple[PostureSession, Record], ...]:
        """Both with their records, the later one last."""
        later = [(self.later.session, self.later.record)] if self.later else []
        return ((self.result.session, self.result.record), *later)

    @property
    def limits(self) -> list[str]:
        """What a reader must know before using the numbers, the gravest first."""
        return [
            *(record.unfinished for _, record in self.sessions if record.unfinished),
            *caveats(HexaSlideCalibrationReport.of(self.calibration)),
            *remark_lines(self.result.session),
        ]

    @property
    def digests(self) -> tuple[str, ...]:
        """Digests of the records, in their order."""
        return tuple(record.digest for _, record in self.sessions)

    @property
    def terms(self) -> str:
        """The terms as of `terms_of`."""
        return terms_of(self.tolerance_mm)

    @property
    def identification(self) -> str:
        """The identification as of `identification_of`."""
        return identification_of(self.head, self.digests)


def certified_postures(
    path: Path,
    later_path: Path | None = None,
    tolerance_mm: float | None = None,
    head: CertificateHead | None = None,
) -> CertifiedPostures:
    """Certify a session and a later one. Raises as `posture_result` and `verify_sessions`."""
    check_tolerance(tolerance_mm)
    later = None
    if later_path is not None:
        verified = verify_sessions(path, later_path, tolerance_mm)
        later = VerifyingSession(*read_postures(later_path), verified)
    return CertifiedPostures(posture_result(path), later, tolerance_mm, head)
