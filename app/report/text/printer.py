"""For the owner of a printer: what to change, does it repeat, how good can it get."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from rich.table import Table

from app.evaluating.printer import BEYOND_NOISE, LEAST, PrinterChange
from app.evaluating.solution import SessionSolution
from app.report.text.tables import decimals, new_table, signed, uncertain
from calib.tripod.effects.bars import LegLength
from calib.tripod.effects.drives import ActuatorScale, AxisOffset, AxisSquareness, Backlash
from calib.tripod.effects.effect import EffectInstance, remedies

WHERE = (
    "The endstop is position_endstop of Klipper, H + M666 of RepRapFirmware, H − M666 of Marlin. "
    "glidecal export --format klipper, reprapfirmware or marlin writes all of it as a file."
)
SCREWS = (
    "In place of new values, the screws of the endstops can move the switches by the last column."
)
WITHIN_TOLERANCES = (
    "That is more than contacts scatter, but not more than parts within their tolerances explain: "
    "towers that lean, belts, the plate. Firmware has no value for these."
)
WITHOUT_AN_ENTRY = (
    "That is more than contacts scatter: a belt, a bent tower, a plate that is not flat, or "
    "anything else without an entry. glidecal diagnose looks for it."
)
NO_REPEATS = (
    "No place was probed twice, so nothing shows whether contacts repeat. Probe every place three "
    "times (glidecal plan --macro)."
)
SIZE_IS_OPEN = (
    "The bound on the tool is larger, because contacts with a plate do not show how large the "
    "machine is: bars, radius and belts that are all off alike. Measure distances on a printed "
    "object (glidecal import --distances)."
)
NOT_WORTH_IT = (
    "WARNING: these values are not expected to make the tool more accurate. Look with glidecal "
    "diagnose for the cause before you enter them."
)

SIZE_SHOWS = 3.0
"""Times the unevenness with the values: a bound beyond it is of what the plate does not show."""


def change_parts(result: SessionSolution, change: PrinterChange) -> list[str | Table]:
    """What to change, then what the contacts say of probe, geometry and size."""
    where = f"{WHERE} {SCREWS}" if change.endstops_alone and change.helps else WHERE
    return [*change_tables(change), where, "\n".join(change_answers(result, change))]


def change_tables(change: PrinterChange) -> list[Table]:
    """What the firmware holds now, tower by tower, and what it is to hold; travels if any."""
    return [_change_table(change), *([_travel_table(change)] if change.travels else [])]


def _then(change: PrinterChange) -> str:
    """The heading of values; those that are not worth it are only what the readings fit."""
    return "enter" if change.helps else "fit"


def _change_table(change: PrinterChange) -> Table:
    then = _then(change)
    if change.endstops_alone:
        move = "or move the switch by, mm" if change.helps else "or the switch by, mm"
        rows = (
            (t.tower, f"{t.endstop.now:.3f}", f"{t.endstop.then:.3f}", signed(-t.endstop.change))
            for t in change.towers
        )
        return new_table("tower", "endstop now, mm", then, move, rows=rows)
    table = new_table("mm", "endstop", then, "arm", then, "angle, °", then)
    for tower in change.towers:
        pairs = (tower.endstop, tower.arm, tower.angle)
        row = [f"{value:.3f}" for entry in pairs for value in (entry.now, entry.then)]
        table.add_row(f"tower {tower.tower}", *row)
    radius = change.radius
    if abs(radius.change) >= LEAST:
        table.add_row("radius", f"{radius.now:.3f}", f"{radius.then:.3f}", *[""] * 4)
    return table


def _travel_table(change: PrinterChange) -> Table:
    entry_name = "rotation_distance, mm" if change.turns else "steps per mm, M92"
    table = new_table("belt", entry_name, _then(change), "travels further by, mm/m")
    for tower in change.towers:
        if travel := tower.travel:
            part = travel.then / travel.now if change.turns else travel.now / travel.then
            further = signed(1000.0 * (part - 1.0))
            figures = f"{travel.now:.4f}", f"{travel.then:.4f}", further
            table.add_row(f"belt {tower.tower}", *figures)
    return table


def change_answers(result: SessionSolution, change: PrinterChange) -> Iterator[str]:
    """Does it repeat; is it the probe or the geometry; how good can it get."""
    noise, uneven = result.noise, change.uneven_mm
    scatter_mm = change.scatter_mm
    if not change.helps and not change.probe_limits:
        yield NOT_WORTH_IT
    if uneven is None:
        return
    if scatter_mm is None and noise.repeated != "equal":
        yield NO_REPEATS
    elif scatter_mm is not None:
        yield (
            f"Contacts at one place repeat to {uncertain(scatter_mm)} mm (standard deviation, "
            f"{noise.scatter_of_repeats[1]:.0f} degrees of freedom)."
        )
    if change.probe_limits:
        yield (
            f"The heights of the plate differ by {uncertain(uneven.now)} mm r.m.s., hardly more "
            "than that: the probe limits what can be seen, not the geometry."
            + ("" if change.helps else " Change nothing in the firmware.")
        )
    else:
        yield (
            f"The heights of the plate differ by {uncertain(uneven.now)} mm r.m.s. With these "
            f"values the same contacts would differ by {uncertain(uneven.then)} mm."
        )
        if scatter_mm is not None and uneven.then > BEYOND_NOISE * scatter_mm:
            yield WITHIN_TOLERANCES if result.verdict == "agrees" else WITHOUT_AN_ENTRY
    if change.bound_mm > SIZE_SHOWS * uneven.then and not any(
        session.distances for session in result.sessions
    ):
        yield SIZE_IS_OPEN


def tower_remedies(effects: Sequence[EffectInstance], towers: Mapping[str, str]) -> tuple[str, ...]:
    """What to do on a printer against effects of these drives; ``towers`` names them by drive.

    Where a printer has no words of its own, or ``towers`` is empty, those of any machine.
    """
    effects = [effect for effect in effects if abs(effect.values[0]) >= LEAST]
    of_towers = [_remedy(effect, towers) for effect in effects] if towers else [None]
    return tuple(filter(None, of_towers)) if all(of_towers) else remedies(effects)


def _remedy(effect: EffectInstance, towers: Mapping[str, str]) -> str | None:
    value, half = float(effect.values[0].real), 2.0 * sum(effect.deviations[:1])
    sign, size = "-" * (value < 0.0), f"{abs(value):.{decimals(half) if half > 0.0 else 3}f} mm"
    names = [towers.get(letter, "") for letter in effect.place]
    law, tower = effect.effect, names[0]
    if isinstance(law, ActuatorScale):
        times, places = 1.0 + value / 1000.0, decimals(half / 1000.0) if half > 0.0 else 5
        return (
            f"belt of tower {tower}: multiply its rotation_distance (Klipper) by "
            f"{times:.{places}f}, or its steps per mm (M92) by {1.0 / times:.{places}f}; where "
            "glidecal solve lists it, enter that value instead, with all others there. A pulley or "
            "belt is not as stated, or stretched. Then home, probe again, and import that"
        )
    if isinstance(law, Backlash):
        return f"belt or joints of tower {tower} are slack by {sign}{size}: tighten them"
    if isinstance(law, LegLength):
        return f"arm of tower {tower}: {sign or '+'}{size}, in the exported values"
    if type(law) is AxisOffset and effect.place[1:] in ("r", "t"):
        out, back = ("out", "in") if effect.place[1:] == "r" else ("anticlockwise", "clockwise")
        way, against = (out, back) if value > 0.0 else (back, out)
        return (
            f"foot of tower {tower} is {size} too far {way}: the exported values allow for it; or "
            f"move the tower {against}"
        )
    if isinstance(law, AxisSquareness):
        way = "apart" if value > 0.0 else "together"
        return (
            f"towers {' and '.join(names)} lean, for which firmware has no value: with their feet "
            f"where they are, move their tops {way}, {size} for each metre of height"
        )
    return None
