"""What a digital certificate says of a machine on six chains."""

from __future__ import annotations

from collections.abc import Iterator

from app.report.dcc.document import UNITS, CertifiedValue, Result
from app.report.hexaslide_certificate import CertifiedPostures, machine_numbers
from app.report.schema.hexaslide import PlatformReport

THOUSANDTHS = {"m": UNITS["mm"], "rad": UNITS["mrad"]}
NOT_ALONE = (
    "No reading shows these values one by one. What they are worth is in the lengths that no frame "
    "changes, and in the error of the platform."
)
SOME_ALONE = (
    "Those that readings show one by one are below, with their uncertainty. What all of them are "
    "worth is in the lengths that no frame changes, and in the error of the platform."
)


def results_of(certified: CertifiedPostures) -> Iterator[Result]:
    """The machine to enter, what is known of it, and errors of the platform."""
    document = certified.document
    text = SOME_ALONE if document.individually_known else NOT_ALONE
    entered = [
        CertifiedValue(f"{part}: {key}", value, UNITS["m/m" if key.startswith("rail") else "mm"])
        for part, key, value in machine_numbers(certified.calibrated)
    ]
    yield Result("Values to enter", text, entered)
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
            _scaled(name, "m", v.value_m, v.expanded_uncertainty_m, v.standard_uncertainty_m)
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
                    p.expanded_uncertainty,
                    p.standard_uncertainty,
                )
                for name, p in alone
            ],
        )
    if certified.verification:
        again = PlatformReport.of(certified.verification.after.platform)
        yield Result(
            "Error of the platform over the box, measured again",
            "From the later session, with the calibrated machine entered.",
            [*_platform(again, "as measured again", "by how much that may be off")],
        )


def _scaled(
    name: str, unit: str, value: float, expanded: float | None, standard: float | None
) -> CertifiedValue:
    """A value in thousandths of its unit; a component of a direction stays as it is."""
    size = 1000.0 if unit in THOUSANDTHS else 1.0
    sizes = (None if part is None else size * part for part in (expanded, standard))
    return CertifiedValue(name, size * value, THOUSANDTHS.get(unit, UNITS["m/m"]), *sizes)


def _platform(platform: PlatformReport, now: str, bound: str) -> Iterator[CertifiedValue]:
    """The platform's error, and a bound where one is known."""
    yield CertifiedValue(f"root mean square, {now}", platform.now_rms_mm)
    yield CertifiedValue(f"largest, {now}", platform.now_worst_mm)
    if platform.bound_rms_mm is not None:
        text = "Upper 95 % bound of the root mean square."
        yield CertifiedValue(f"bound, {bound}", platform.bound_rms_mm, words=text)
