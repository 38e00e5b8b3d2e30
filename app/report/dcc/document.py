"""The results of sessions as a digital calibration certificate, XML."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources

from jinja2 import Environment, StrictUndefined, Template

from app.report.certificate import CertificateHead, CertifiedCalibration
from app.report.text.correction import FREE_WORDS, frames_of
from app.version import version
from calib.arrays import LEG_NAMES
from calib.errors import UsageError
from calib.posterior.tool import Frame
from calib.printable import printable

COVERAGE_PROBABILITY = 0.95

UNITS = {
    "mm": r"\milli\metre",
    "1/mm": r"\milli\metre\tothe{-1}",
    "°": r"\degree",
    "°C": r"\degreecelsius",
}
"""As D-SI writes them."""


@dataclass(frozen=True)
class Uncertainty:
    """Expanded for 95 %, with the standard uncertainty, in the unit of the value."""

    expanded: float
    standard: float

    @property
    def coverage_factor(self) -> float:
        """Their ratio; of a mixture of models it may be any."""
        return self.expanded / self.standard


@dataclass(frozen=True)
class CertifiedValue:
    """A value in a unit of D-SI; ``words`` say what it is, if the name does not."""

    name: str
    value: float
    unit: str
    uncertainty: Uncertainty | None = None
    words: str = ""

    @property
    def interval(self) -> tuple[float, float]:
        """From where to where, 95 %."""
        half = 0.0 if self.uncertainty is None else self.uncertainty.expanded
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
        stated = "no number, customer and laboratory"
        raise UsageError(thing, stated, "a report with --certificate FILE")
    if head.laboratory.country is None:
        raise UsageError(
            thing,
            "no country of the laboratory in the settings file",
            'country = "DE" in its table [laboratory], as ISO 3166-1 writes it',
        )
    return head


def certificate_xml(calibration: CertifiedCalibration) -> str:
    """The certificate, not signed. Raises as `check_head`."""
    head = check_head(calibration.head)
    text = _template().render(
        order=head.order,
        laboratory=head.laboratory,
        machine=calibration.machine.name,
        serial_number=calibration.serial_number,
        sessions=calibration.sessions,
        days=sorted(session.opened.at.date() for session in calibration.sessions),
        procedures=_procedures(calibration),
        instruments=calibration.instruments,
        temperatures=_temperatures(calibration),
        results=[*results_of(calibration)],
        conformities=[*_conformities(calibration)],
        diagnosis=calibration.diagnosed.diagnosis,
        tolerance=CertifiedValue("tolerance", calibration.tolerance_mm or 0.0, UNITS["mm"]),
        probability=COVERAGE_PROBABILITY,
        program_version=version(),
    )
    return "".join(line for line in text.splitlines(keepends=True) if not line.isspace())


def results_of(calibration: CertifiedCalibration) -> Iterator[Result]:
    """Values to enter, errors of the tool, and what a later session says of the values."""
    solved, frame = calibration.solved, calibration.solved.frame
    yield Result("Values to enter", *_entered(calibration))
    now, then = solved.corrections.off_now.bound_mm, solved.entered.off.bound_mm
    yield Result(
        "Error of the tool over the workspace",
        "Root mean square that 95 of 100 machines with these readings keep.",
        [
            *_bounds(frame, now, "as measured"),
            *_bounds(frame, then, "with the values entered, predicted"),
        ],
    )
    view = solved.solution
    columns = (view.values_mm, view.expanded_mm, view.uncertainty_mm)
    yield Result(
        f"Identified parameters, set {view.subset}",
        "The uncertainty is of the noise of the readings alone; parts may be off within their "
        "tolerance beside it.",
        [
            _in_mm(name, value, (wide, u))
            for name, value, wide, u in zip(
                view.names, *(column.tolist() for column in columns), strict=True
            )
        ],
    )
    if not calibration.verified:
        return
    later = calibration.verified.compared.after
    yield Result(
        "Error of the tool after the values were entered",
        "Root mean square that 95 of 100 machines with the later readings keep.",
        [*_bounds(later.frame, later.corrections.off_now.bound_mm, "as measured again")],
    )
    yield Result(
        "Joint offsets that remain",
        "From the later session; the uncertainty is of both sessions.",
        [
            _in_mm(offset.name, offset.found_mm, (offset.expanded_mm, offset.standard_mm))
            for offset in calibration.verified.offsets
        ],
    )


def _entered(calibration: CertifiedCalibration) -> tuple[str, list[CertifiedValue]]:
    """What they are, and the values: those of a printer's firmware, else joint offsets."""
    solved = calibration.solved
    if change := solved.printer_change:
        towers = [
            CertifiedValue(f"tower {tower.tower}: {name}", entry.then, unit)
            for tower in change.towers
            for name, entry, unit in (
                ("endstop", tower.endstop, UNITS["mm"]),
                ("arm", tower.arm, UNITS["mm"]),
                ("angle", tower.angle, UNITS["°"]),
            )
        ]
        radius = CertifiedValue("radius", change.radius.then, UNITS["mm"])
        held = ("rotation_distance", "mm") if change.turns else ("steps per mm", "1/mm")
        travels = [
            CertifiedValue(f"tower {tower.tower}: {held[0]}", tower.travel.then, UNITS[held[1]])
            for tower in change.towers
            if tower.travel
        ]
        words = "Values that the firmware of the printer is to hold."
        return words, [*towers, radius, *travels]
    standard, expanded = (column.tolist() for column in solved.corrections.uncertainties_mm())
    values = zip(LEG_NAMES, solved.joint_offsets_mm, expanded, standard, strict=True)
    return (
        "True position of a joint = believed position + d_rho; added to what was entered before.",
        [_in_mm(f"d_rho_{leg}", value, (wide, u)) for leg, value, wide, u in values],
    )


def _in_mm(name: str, value_mm: float, uncertainty_mm: tuple[float, float]) -> CertifiedValue:
    return CertifiedValue(name, value_mm, UNITS["mm"], Uncertainty(*uncertainty_mm))


def _bounds(first: Frame, bound_mm: dict[Frame, float], when: str) -> Iterator[CertifiedValue]:
    for frame in frames_of(first):
        name = f"{FREE_WORDS[frame]}, {when}"
        yield CertifiedValue(name, bound_mm[frame], UNITS["mm"], words="Upper 95 % bound.")


def _procedures(calibration: CertifiedCalibration) -> list[str]:
    procedures = (session.opened.procedure for session in calibration.sessions)
    names = (procedure.name if procedure else "table of readings" for procedure in procedures)
    return list(dict.fromkeys(names))


def _temperatures(calibration: CertifiedCalibration) -> list[CertifiedValue]:
    return [
        CertifiedValue(f"temperature, {session.name}", session.opened.temperature_c, UNITS["°C"])
        for session in calibration.sessions
        if session.opened.temperature_c is not None
    ]


def _conformities(calibration: CertifiedCalibration) -> Iterator[tuple[str, str]]:
    """What was judged, and the decision; undecided is none of the words of the schema."""
    judged = calibration.judged
    if judged is None:
        return
    yield "tool as measured", judged.before
    yield "tool with the values entered, predicted", judged.after
    if calibration.verified and calibration.verified.decision:
        yield "tool measured again with the values entered", calibration.verified.decision


@cache
def _template() -> Template:
    environment = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_shown,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["stated"] = _stated
    text = resources.files("app.report.dcc").joinpath("dcc.xml").read_text(encoding="utf-8")
    return environment.from_string(text)


def _shown(value: object) -> object:
    """Texts in one line without hidden characters, numbers with all of their digits."""
    if type(value) is float:
        if not math.isfinite(value):
            raise ValueError("a value that is not finite")
        return repr(value)
    return " ".join(printable(value).split()) if type(value) is str else value


def _stated(parts: Iterable[str | None]) -> list[str]:
    """Those of which something is left on one line: the schema allows no empty text."""
    lines = (" ".join(printable(part).split()) for part in parts if part)
    return [line for line in lines if line]
