"""What to enter in the controller, in words and tables: values, what the tool keeps, what else."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

from rich.table import Table

from app.evaluating.correction import SessionCorrection
from app.evaluating.printer import PrinterChange
from app.evaluating.solution import LineParameter, SessionSolution
from app.report.text.printer import change_parts
from app.report.text.tables import new_table, result_table, signed, uncertain
from calib.identify.solution import Subset
from calib.posterior.tool import FRAMES
from calib.quantity import probability_words

if TYPE_CHECKING:
    from calib.posterior.correction import LeftOut, ToolOff
    from protocols.machine import Frame

SUBSET_WORDS: dict[Subset, str] = {
    "joint-offsets": "joint offsets",
    "leg-lengths": "leg lengths",
    "both": "joint offsets and leg lengths",
    "with-tolerances": "both, constrained by tolerances",
}

FRAME_WORDS: dict[Frame, str] = {
    "touched-off": "for a touched-off workpiece",
    "aligned": "for an aligned workpiece",
    "machine": "in the machine's own frame",
}

FREE_WORDS: dict[Frame, str] = {
    "touched-off": "touched off: a shift is free",
    "aligned": "aligned: a shift and a turn are free",
    "machine": "the machine's own frame",
}

HOLDS_WORDS = {
    "offsets": "joint offsets alone",
    "play": "joint offsets and play",
    "tables": "a table of each joint (linuxcnc)",
    "kinematics": "own kinematics (linuxcnc-kins)",
}

BOUND = "Tool over the workspace, r.m.s. (95 %): "
"""So the sentence on the bound begins, in results and in files."""

UNSEEN = (
    "Readings of legs do not show a turn of the whole machine. Where a turn is not free, the "
    "figure contains it. A square or a ball bar shows it."
)


def correction_table(correction: SessionCorrection) -> Table:
    """The values to enter, or those that are not worth it."""
    of_offsets = correction.uncertainties_mm
    headings = ["value", "", *(["± U (95 %)"] if of_offsets else [])]
    table = new_table("enter" if correction.helps else "", *headings)
    for number, (name, entry) in enumerate(correction.values.items()):
        width = [uncertain(float(of_offsets[1][number]), 4)] if of_offsets else []
        table.add_row(name, shown_value(entry.value), entry.unit, *width)
    return table


def shown_value(value: float) -> str:
    """A value to enter as it is shown wherever it is."""
    return signed(value, 4)


def frames_of(frame: Frame) -> list[Frame]:
    """The chosen frame, then the others."""
    return [frame, *(frame_beside for frame_beside in FRAMES if frame_beside != frame)]


def before_or_now(entered: bool) -> str:
    """The word for the time without the values: it is over where they are ``entered`` since."""
    return "before" if entered else "now"


def bound_table(first: Frame, off_now: ToolOff, off: ToolOff, *, entered: bool = False) -> Table:
    """What the tool is off by at most, without the values and with them, in each frame."""
    when = f"{before_or_now(entered)}, mm"
    rows = (
        (FREE_WORDS[frame], *(uncertain(state.bound_in(frame)) for state in (off_now, off)))
        for frame in frames_of(first)
    )
    return new_table("tool error, r.m.s. (95 %)", when, "with these values, mm", rows=rows)


def gains_table(result: SessionSolution) -> Table:
    """What other exports of the same controller would keep."""
    rows = (
        (HOLDS_WORDS[gain.holds], uncertain(gain.bound_mm))
        for gain in result.corrections.others(result.correction)
    )
    return new_table("if the controller has", "tool at most, mm", rows=rows)


def value_parts(
    result: SessionSolution, values: Table, *, entered: bool = False
) -> list[str | Table]:
    """Doubts, the ``values`` or those of a printer's firmware, the bound, what else helps.

    The values may be ``entered`` since.
    """
    correction = result.correction
    bound = bound_table(correction.frame, correction.off_now, result.entered.off, entered=entered)
    if change := result.printer_change:
        doubts = "\n".join(doubt_lines(result))
        return [doubts, *change_parts(result, change), bound, *line_parts(result)]
    return [
        "\n".join(warning_lines(result, correction)),
        values,
        bound,
        "" if result.reads_tool else UNSEEN,
        gains_table(result),
        *line_parts(result),
        "\n".join(left_out_lines(correction.left_out)),
    ]


def line_parts(result: SessionSolution) -> list[str | Table]:
    """Lines of the drives within their tolerances; nothing where the machine file has none."""
    return [result_table(LineParameter, result.lines)] if result.lines else []


def off_line(frame: Frame, off_now: ToolOff, off: ToolOff) -> str:
    """The bound as one line, the chosen frame first."""
    first, *frames_beside = frames_of(frame)
    frames = ", ".join(
        f"{FRAME_WORDS[name]} {uncertain(off.bound_in(name))} mm" for name in frames_beside
    )
    return (
        f"{BOUND}at most {uncertain(off_now.bound_in(first))} mm now, at most "
        f"{uncertain(off.bound_in(first))} mm with these values, {FRAME_WORDS[first]}; {frames}."
    )


def left_out_lines(left_out: Iterable[LeftOut]) -> Iterator[str]:
    """Parts that are not entered, a line for each reason."""
    by_reason: dict[str, list[str]] = {}
    for part in left_out:
        by_reason.setdefault(part.reason, []).append(part.part)
    for reason, parts in by_reason.items():
        yield f"Left out: {', '.join(parts)}. Reason: {reason}."


def gain_line(result: SessionSolution, correction: SessionCorrection) -> str:
    """What other exports of the same controller would gain, as one line."""
    labels = {**HOLDS_WORDS, correction.holds: "this export with the parts that it leaves out"}
    gains = [
        f"{labels[gain.holds]} at most {uncertain(gain.bound_mm)} mm"
        for gain in result.corrections.others(correction)
        if gain.clear
    ]
    if not gains:
        return "No other export for this controller would leave clearly less at the tool."
    return (
        "Other exports for this controller would leave clearly less at the tool: "
        f"{'; '.join(gains)}."
    )


def correction_lines(result: SessionSolution, correction: SessionCorrection) -> Iterable[str]:
    """What every file of a correction says of it."""
    change = result.printer_change if correction.holds != "kinematics" else None
    return (
        off_line(correction.frame, correction.off_now, correction.off),
        *left_out_lines(correction.left_out),
        firmware_line(change) if change else gain_line(result, correction),
        *warning_lines(result, correction),
    )


def firmware_line(change: PrinterChange) -> str:
    """What a file without the values of a printer's firmware lacks, and the bound with them."""
    return (
        "NOTE: arm lengths, radius and angles of the firmware are not among these values. With all "
        f"values of the firmware entered, the tool is off by at most {uncertain(change.bound_mm)} "
        "mm: --format klipper, reprapfirmware or marlin, and firmware of --format json."
    )


def warning_lines(result: SessionSolution, correction: SessionCorrection) -> Iterator[str]:
    """Mistakes of the readings that may be there, and that values are not worth entering."""
    yield from doubt_lines(result)
    if not correction.helps:
        yield (
            "WARNING: these values are not expected to make the tool more accurate: the bound "
            "with them is not clearly smaller than the bound now."
        )


def doubt_lines(result: SessionSolution) -> Iterator[str]:
    """Mistakes of the readings that may be there."""
    mistakes = result.corrections.mistakes
    if mistakes:
        mistake_words = ", or ".join(
            f"{mistake.title} ({mistake.where}), {probability_words(mistake.probability)}"
            for mistake in mistakes
        )
        likely = "likely" if mistakes[0].probability > 0.5 else "perhaps"
        yield (
            f"WARNING: {likely} a mistake in the readings, with its probability: "
            f"{mistake_words}. The values are those of the likeliest labels, the tool error is "
            "over all; the record is not changed. Check it, and measure again."
        )
    if furthest := result.furthest_distance:
        distance = furthest.distance
        way = "longer" if furthest.deviations > 0.0 else "shorter"
        yield (
            f"WARNING: distance {distance.distance} of {furthest.session}, "
            f"{distance.value_mm:g} mm, is {abs(furthest.deviations):.0f} standard deviations "
            f"{way} than all other readings give. "
            "Measure it again, or remove it."
        )


def sole_mistake_words(result: SessionSolution) -> Iterator[str]:
    """The likeliest mistake of the readings in one line, if any."""
    for mistake in result.corrections.mistakes[:1]:
        yield (
            f"WARNING: likely a mistake in the readings: {mistake.title} ({mistake.where}). "
            "Measure again."
        )


def view_words(result: SessionSolution) -> str:
    """The sentence that a set of the papers is written in place of the correction."""
    return (
        f"NOTE: the set {result.subset} is written as it was asked for. Without --subset and "
        "--method the export writes the correction that leaves least at the tool."
    )
