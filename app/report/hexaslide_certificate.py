"""What a report and a certificate of a session of postures are made of."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from app.evaluating.hexaslide import PostureResult, posture_result
from app.evaluating.hexaslide_calibration import VerifiedMachine, decided, verify_sessions
from app.evaluating.tolerance import check_tolerance
from app.report.certificate import CertificateHead, Certified, CertifiedRecord, terms_of
from app.report.schema.hexaslide import HexaSlideCalibrationReport
from app.report.text.hexaslide_calibration import caveats
from app.report.text.hexaslide_diagnosis import verdict_words
from app.report.text.hexaslide_session import remark_lines
from calib.identify.accuracy import Decision
from protocols.hexaslide import HexaSlideMachine, machine_like
from protocols.hexaslide_session import PostureSession, read_postures


@dataclass(frozen=True, eq=False, kw_only=True)
class CertifiedPostures(Certified):
    """The results of a session, and of a later one with the calibrated machine entered.

    ``document`` has the numbers of the result, ``decision`` is on the platform as it was measured,
    None without a tolerance. ``sessions`` are both.
    """

    machine: HexaSlideMachine
    result: PostureResult
    document: HexaSlideCalibrationReport
    verification: VerifiedMachine | None
    decision: Decision | None
    sessions: tuple[PostureSession, ...]

    @property
    def calibrated(self) -> HexaSlideMachine:
        """The machine file to enter."""
        calibration = self.result.calibration
        return machine_like(calibration.source.machine, "", calibration.entered)


def machine_numbers(machine: HexaSlideMachine) -> Iterator[tuple[str, str, float]]:
    """Every number that a calibration gives a machine file: of which part, by which key and axis.

    Lengths in mm; a rail's are components of its direction.
    """
    parts: dict[str, dict[str, Sequence[float]]] = {
        f"chain {number}": {
            "start_mm": chain.start_mm,
            "joint_mm": chain.joint_mm,
            "link_mm": [chain.link_mm],
            "rail": chain.rail or (),
        }
        for number, chain in enumerate(machine.chain, start=1)
    }
    if link := machine.constraint_link:
        parts["constraint link"] = {
            "platform_end_mm": link.platform_end_mm,
            "base_end_mm": link.base_end_mm,
            "length_mm": [link.length_mm],
        }
    for part, keys in parts.items():
        for key, values in keys.items():
            axes = {3: "xyz", 1: " "}.get(len(values), "")
            for axis, value in zip(axes, values, strict=True):
                yield part, f"{key} {axis}".rstrip(), value


def certified_postures(
    path: Path,
    later_path: Path | None = None,
    tolerance_mm: float | None = None,
    head: CertificateHead | None = None,
    result: PostureResult | None = None,
) -> CertifiedPostures:
    """Certify a session, of which the ``result`` may be there already, and a later one.

    The tolerance is that of the verification, else as given, else of the machine file. Raises as
    `posture_result` and `verify_sessions`.
    """
    check_tolerance(tolerance_mm)
    verified = verify_sessions(path, later_path, tolerance_mm) if later_path else None
    result = result or posture_result(path)
    calibration, diagnosis = result.calibration, result.diagnosis
    machine, document = calibration.source.machine, HexaSlideCalibrationReport.of(calibration)
    tolerance_mm = tolerance_mm or machine.platform_tolerance_mm
    if verified:
        tolerance_mm = verified.tolerance_mm
    decision = None if tolerance_mm is None else decided(calibration, tolerance_mm)
    pairs = [(result.session, result.record), *([read_postures(later_path)] if later_path else [])]
    return CertifiedPostures(
        head=head,
        name=machine.name,
        serial_number=machine.serial_number,
        machine=machine,
        records=tuple(
            CertifiedRecord(
                *(session.name, record.digest, opened, session.readings),
                *(opened.operator, opened.temperature_c, opened.procedure.name),
            )
            for session, record in pairs
            for opened in [session.opened]
        ),
        gauge="instrument",
        instruments=head.order.instrument if head else (),
        attached=f"Attached: {result.session.opened.procedure.attach or 'not stated.'}",
        completeness=f"{diagnosis.verdict}: {verdict_words(diagnosis)}"
        if diagnosis
        else f"not diagnosed: {result.not_diagnosed}",
        warnings=[],
        limits=[
            *(record.unfinished for _, record in pairs if record.unfinished),
            *caveats(document),
            *remark_lines(result.session),
        ],
        moved="platform",
        tolerance_mm=tolerance_mm,
        decisions={
            "platform as measured": decision,
            "platform measured again with the calibrated machine": verified.decision
            if verified
            else None,
        },
        terms=terms_of(tolerance_mm),
        result=result,
        document=document,
        verification=verified,
        decision=decision,
        sessions=tuple(session for session, _ in pairs),
    )
