"""What a digital certificate says of a machine with three drives."""

from __future__ import annotations

from collections.abc import Iterator

from app.report.certificate import CertifiedCalibration
from app.report.dcc.document import UNITS, CertifiedValue, Result
from app.report.text.correction import FREE_WORDS, frames_of
from calib.arrays import LEG_NAMES
from calib.identify.solution import Solution
from calib.posterior.tool import Frame


def results_of(calibration: CertifiedCalibration) -> Iterator[Result]:
    """Values to enter, errors of the tool, and what a later session says of the values."""
    result, frame = calibration.result, calibration.result.frame
    yield Result("Values to enter", *_entered(calibration))
    now, then = result.corrections.off_now.bound_mm, result.entered.off.bound_mm
    yield Result(
        "Error of the tool over the workspace",
        "Root mean square that 95 of 100 machines with these readings keep.",
        [
            *_bounds(frame, now, "as measured"),
            *_bounds(frame, then, "with the values entered, predicted"),
        ],
    )
    if view := result.view_solution:
        yield _of_view(view)
    if not calibration.verification:
        return
    later = calibration.verification.compared.after
    yield Result(
        "Error of the tool after the values were entered",
        "Root mean square that 95 of 100 machines with the later readings keep.",
        [*_bounds(later.frame, later.corrections.off_now.bound_mm, "as measured again")],
    )
    yield Result(
        "Joint offsets that remain",
        "From the later session; the uncertainty is of both sessions.",
        [
            CertifiedValue(o.name, o.found_mm, UNITS["mm"], o.expanded_mm, o.standard_mm)
            for o in calibration.verification.offsets
        ],
    )


def _of_view(view: Solution) -> Result:
    """The parameters of one set of the papers."""
    expanded_mm, standard_mm = view.expanded_with_tolerances_mm, view.uncertainty_with_tolerances_mm
    columns = (view.values_mm, expanded_mm, standard_mm)
    return Result(
        f"Identified parameters, set {view.subset}",
        "The uncertainty is of the noise of the readings and of parts within their tolerance.",
        [
            CertifiedValue(name, value, UNITS["mm"], wide, u)
            for name, value, wide, u in zip(
                view.names, *(column.tolist() for column in columns), strict=True
            )
        ],
    )


def _entered(calibration: CertifiedCalibration) -> tuple[str, list[CertifiedValue]]:
    """What they are, and the values: those of a printer's firmware, else joint offsets."""
    result = calibration.result
    if change := result.printer_change:
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
        quantity = ("rotation_distance", "mm") if change.turns else ("steps per mm", "1/mm")
        travels = [
            CertifiedValue(
                f"tower {tower.tower}: {quantity[0]}", tower.travel.then, UNITS[quantity[1]]
            )
            for tower in change.towers
            if tower.travel
        ]
        text = "Values that the firmware of the printer is to hold."
        return text, [*towers, radius, *travels]
    standard, expanded = (column.tolist() for column in result.corrections.uncertainties_mm())
    values = zip(
        LEG_NAMES,
        result.joint_offsets_mm,
        [UNITS["mm"]] * 3,
        expanded,
        standard,
        strict=True,
    )
    return (
        "To add to what was entered before; true position of a joint = believed position + d_rho. "
        "The tool is off least with these values: they, not the joints alone, are within ± U.",
        [CertifiedValue(f"d_rho_{leg}", *row) for leg, *row in values],
    )


def _bounds(first: Frame, bound_mm: dict[Frame, float], when: str) -> Iterator[CertifiedValue]:
    for frame in frames_of(first):
        name = f"{FREE_WORDS[frame]}, {when}"
        yield CertifiedValue(name, bound_mm[frame], UNITS["mm"], words="Upper 95 % bound.")
