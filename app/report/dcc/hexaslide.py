"""What a digital certificate says of a machine on six chains."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from app.report.dcc.document import (
    UNITS,
    CertificateContents,
    CertifiedValue,
    RecordedSession,
    Result,
    Uncertainty,
    check_head,
)
from app.report.hexaslide_certificate import CertifiedPostures
from app.report.schema.hexaslide import HexaSlideCalibrationReport, PlatformReport
from app.report.text.hexaslide_diagnosis import verdict_words
from protocols.dates import is_dated, measured_days
from protocols.hexaslide import HexaSlideMachine, machine_like
from protocols.hexaslide_session import PostureSession
from protocols.record import Record

THOUSANDTHS = {"m": UNITS["mm"], "rad": UNITS["mrad"]}
NOT_ALONE = (
    "No reading shows these values one by one. What they are worth is in the lengths that no frame "
    "changes, and in the error of the platform."
)


def contents_of(certified: CertifiedPostures) -> CertificateContents:
    """Raises as `check_head`."""
    head, result = check_head(certified.head), certified.result
    diagnosis = result.diagnosis
    attached = result.session.opened.procedure.attach
    return CertificateContents(
        head=head,
        machine=result.solved.source.machine.name,
        serial_numbers=certified.serial_numbers,
        sessions=[_recorded(session, record) for session, record in certified.sessions],
        instruments=head.order.instrument,
        traceability="Lengths and angles are those of the instruments. Each names its "
        f"calibration certificate, where one was stated. Attached: {attached or 'not stated.'}",
        completeness=f"not diagnosed: {result.not_diagnosed}"
        if diagnosis is None
        else f"{diagnosis.verdict}: {verdict_words(diagnosis)}",
        results=[*_results(certified)],
        moved="platform",
        conformities=[*_conformities(certified)],
        tolerance_mm=certified.tolerance_mm,
    )


def _recorded(session: PostureSession, record: Record) -> RecordedSession:
    opened = session.opened
    return RecordedSession(
        session.name,
        record.digest,
        measured_days(opened, session.readings),
        is_dated(opened),
        opened.origin == "simulated",
        opened.temperature_c,
        opened.procedure.name,
    )


def _results(certified: CertifiedPostures) -> Iterator[Result]:
    """The machine to enter, what is known of it, and errors of the platform."""
    solved, later = certified.solved, certified.later
    document = HexaSlideCalibrationReport.of(solved)
    calibrated = machine_like(solved.source.machine, "", solved.entered)
    yield Result("Values to enter", NOT_ALONE, [*_entered(calibrated)])
    yield Result(
        "Error of the platform over the box",
        "Places of its origin, frames that no reading shows, and that of a tracker, laid over.",
        [*_platform(document.platform, "as measured", "with the calibrated machine, predicted")],
    )
    yield Result(
        "Lengths that no frame changes",
        "B: joints of the platform; A: starts of the rails, or joints of the base; l: links.",
        [
            CertifiedValue(
                name,
                1000.0 * length.value_m,
                UNITS["mm"],
                _scaled(1000.0, length.standard_uncertainty_m, length.expanded_uncertainty_m),
            )
            for name, length in document.inner_lengths.items()
        ],
    )
    alone = {
        name: parameter
        for name, parameter in document.parameters.items()
        if parameter.individually_known
    }
    if alone:
        yield Result(
            "Parameters that are known one by one",
            "As the documentation of the program names them.",
            [
                CertifiedValue(
                    name,
                    (size := 1.0 if parameter.unit == "m/m" else 1000.0) * parameter.value,
                    THOUSANDTHS.get(parameter.unit, UNITS["m/m"]),
                    _scaled(size, parameter.standard_uncertainty, parameter.expanded_uncertainty),
                )
                for name, parameter in alone.items()
            ],
        )
    if later is not None:
        again = PlatformReport.of(later.verified.after.platform)
        yield Result(
            "Error of the platform over the box, measured again",
            "From the later session, with the calibrated machine entered.",
            [*_platform(again, "as measured again", "by how much that may be off")],
        )


def _scaled(size: float, standard: float | None, expanded: float | None) -> Uncertainty | None:
    if standard is None or expanded is None:
        return None
    return Uncertainty(size * expanded, size * standard)


def _platform(platform: PlatformReport, now: str, bound: str) -> Iterator[CertifiedValue]:
    """Its error, and a bound where one is known."""
    unit = UNITS["mm"]
    yield CertifiedValue(f"root mean square, {now}", platform.now_rms_mm, unit)
    yield CertifiedValue(f"largest, {now}", platform.now_worst_mm, unit)
    if platform.bound_rms_mm is not None:
        words = "Upper 95 % bound of the root mean square."
        yield CertifiedValue(f"bound, {bound}", platform.bound_rms_mm, unit, words=words)


def _entered(machine: HexaSlideMachine) -> Iterator[CertifiedValue]:
    """Keys of the machine file."""

    def named(place: str, key: str, values: Sequence[float], unit: str) -> Iterator[CertifiedValue]:
        axes = "xyz" if len(values) > 1 else ("",)
        for axis, value in zip(axes, values, strict=True):
            yield CertifiedValue(f"{place}: {key} {axis}".rstrip(), value, unit)

    millimetres = UNITS["mm"]
    for number, chain in enumerate(machine.chain, start=1):
        place = f"chain {number}"
        yield from named(place, "start_mm", chain.start_mm, millimetres)
        yield from named(place, "joint_mm", chain.joint_mm, millimetres)
        yield from named(place, "link_mm", (chain.link_mm,), millimetres)
        if chain.rail:
            yield from named(place, "rail", chain.rail, UNITS["m/m"])
    if (link := machine.constraint_link) is not None:
        yield from named("constraint link", "platform_end_mm", link.platform_end_mm, millimetres)
        yield from named("constraint link", "base_end_mm", link.base_end_mm, millimetres)
        yield from named("constraint link", "length_mm", (link.length_mm,), millimetres)


def _conformities(certified: CertifiedPostures) -> Iterator[tuple[str, str]]:
    """What was judged, and the decision; undecided is none of the words of the schema."""
    if certified.decision is not None:
        yield "platform as measured", certified.decision
    if certified.later and certified.later.verified.decision:
        yield (
            "platform measured again with the calibrated machine",
            certified.later.verified.decision,
        )
