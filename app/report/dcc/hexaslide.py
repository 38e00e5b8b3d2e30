"""What a digital certificate says of a machine on six chains."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from app.report.certificate import traceability_words
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
SOME_ALONE = (
    "Those that readings show one by one are below, with their uncertainty. What all of them are "
    "worth is in the lengths that no frame changes, and in the error of the platform."
)


def contents_of(certified: CertifiedPostures) -> CertificateContents:
    """Raises as `check_head`."""
    head, result = check_head(certified.head), certified.result
    diagnosis = result.diagnosis
    attached = result.session.opened.procedure.attach
    return CertificateContents(
        head=head,
        machine=result.calibration.source.machine.name,
        serial_numbers=certified.serial_numbers,
        sessions=[_recorded(session, record) for session, record in certified.sessions],
        instruments=head.order.instrument,
        traceability=f"{traceability_words(head.order.instrument, 'instrument')} "
        f"Attached: {attached or 'not stated.'}",
        completeness=f"not diagnosed: {result.not_diagnosed}"
        if diagnosis is None
        else f"{diagnosis.verdict}: {verdict_words(diagnosis)}",
        limits=certified.limits,
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
    result, later = certified.calibration, certified.later
    document = HexaSlideCalibrationReport.of(result)
    calibrated = machine_like(result.source.machine, "", result.entered)
    text = SOME_ALONE if document.individually_known else NOT_ALONE
    yield Result("Values to enter", text, [*_entered(calibrated)])
    yield Result(
        "Error of the platform over the box",
        "Places of its origin, frames that no reading shows, and that of a tracker, laid over.",
        [*_platform(document.platform, "as measured", "with the calibrated machine, predicted")],
    )
    yield Result(
        "Lengths that no frame changes",
        "Of the machine, as expected over all that may be missing in the model. B: joints of the "
        "platform; A: starts of the rails, or joints of the base; l: links.",
        [
            _scaled(name, "m", v.value_m, v.standard_uncertainty_m, v.expanded_uncertainty_m)
            for name, v in document.inner_lengths.items()
        ],
    )
    if document.individually_known:
        alone = [(name, document.parameters[name]) for name in document.individually_known]
        yield Result(
            "Parameters that are known one by one",
            "Of the values to enter, as the documentation of the program names them. They "
            "compensate for what has no parameter, so that a link differs from its length above.",
            [
                _scaled(
                    f"{name} to enter",
                    p.unit,
                    p.value,
                    p.standard_uncertainty,
                    p.expanded_uncertainty,
                )
                for name, p in alone
            ],
        )
    if later is not None:
        again = PlatformReport.of(later.verification.after.platform)
        yield Result(
            "Error of the platform over the box, measured again",
            "From the later session, with the calibrated machine entered.",
            [*_platform(again, "as measured again", "by how much that may be off")],
        )


def _scaled(
    name: str, unit: str, value: float, standard: float | None, expanded: float | None
) -> CertifiedValue:
    """A value in thousandths of its unit; a component of a direction stays as it is."""
    size = 1000.0 if unit in THOUSANDTHS else 1.0
    uncertainty = None
    if standard is not None and expanded is not None:
        uncertainty = Uncertainty(size * expanded, size * standard)
    return CertifiedValue(name, size * value, THOUSANDTHS.get(unit, UNITS["m/m"]), uncertainty)


def _platform(platform: PlatformReport, now: str, bound: str) -> Iterator[CertifiedValue]:
    """The platform's error, and a bound where one is known."""
    unit = UNITS["mm"]
    yield CertifiedValue(f"root mean square, {now}", platform.now_rms_mm, unit)
    yield CertifiedValue(f"largest, {now}", platform.now_worst_mm, unit)
    if platform.bound_rms_mm is not None:
        text = "Upper 95 % bound of the root mean square."
        yield CertifiedValue(f"bound, {bound}", platform.bound_rms_mm, unit, words=text)


def _entered(machine: HexaSlideMachine) -> Iterator[CertifiedValue]:
    """Keys of the machine file."""

    def named(
        place: str, key: str, values: Sequence[float], unit: str = UNITS["mm"]
    ) -> Iterator[CertifiedValue]:
        axes = "xyz" if len(values) > 1 else ("",)
        for axis, value in zip(axes, values, strict=True):
            yield CertifiedValue(f"{place}: {key} {axis}".rstrip(), value, unit)

    for number, chain in enumerate(machine.chain, start=1):
        place = f"chain {number}"
        yield from named(place, "start_mm", chain.start_mm)
        yield from named(place, "joint_mm", chain.joint_mm)
        yield from named(place, "link_mm", [chain.link_mm])
        if chain.rail:
            yield from named(place, "rail", chain.rail, UNITS["m/m"])
    if (link := machine.constraint_link) is not None:
        yield from named("constraint link", "platform_end_mm", link.platform_end_mm)
        yield from named("constraint link", "base_end_mm", link.base_end_mm)
        yield from named("constraint link", "length_mm", [link.length_mm])


def _conformities(certified: CertifiedPostures) -> Iterator[tuple[str, str]]:
    """What was judged, and the decision; undecided is none of the words of the schema."""
    if certified.decision is not None:
        yield "platform as measured", certified.decision
    if certified.later and certified.later.verification.decision:
        yield (
            "platform measured again with the calibrated machine",
            certified.later.verification.decision,
        )
