"""What the screen of the Hexa Slide says."""

from __future__ import annotations

import math
from pathlib import Path

from app.report.text.hexaslide import grouped
from app.report.text.tables import new_table, table_text, wrapped
from calib.arrays import FloatArray
from calib.hexaslide.geometry import COORDINATES
from calib.hexaslide.planning import KINDS, HexaSlideSeen, PublishedSet
from calib.hexaslide.procedures import MEASURABLE_WORDS, Kind
from calib.hexaslide.search import BestPostures

HEXASLIDE_HELP = """\
1 2 3 4       the procedures: whole posture with residuals of the
              sliders, or of the posture; position alone; constraint link
M             measured components of your own, such as x,y,z,theta
F             the machine file of a machine of your own
Tab, arrows   the next page; up and down scroll it
O             search for the best postures; Escape stops the search,
              the best so far stays
C             how many postures to search for
+ -           the machine drawn at the next posture, the one before
Y             copy the text of this page to the clipboard
Escape, F10   back, quit

Drawing: rails ·, links thin with their number, platform thick, box :
Postures: x start, o optimum. A posture is a place and three angles, so
each stands once in every plot. Nothing here writes a file."""

PROCEDURE_WORDS = {
    Kind.POSE_INVERSE: "whole posture, residuals of the sliders",
    Kind.POSE_FORWARD: "whole posture, residuals of the posture",
    Kind.POSITION: "position alone",
    Kind.CONSTRAINT_LINK: "constraint link of fixed length",
}

LOOKING = "Computing what this procedure can identify …"
NO_VIEW = "There is nothing to search: this machine or procedure cannot be used."
NOT_YET = "No postures yet: O searches for the best ones."
WHICH_MACHINE = "Machine file of the Hexa Slide; empty: the example H60."
WHICH_COMPONENTS = f"What is measured of each posture: some of {MEASURABLE_WORDS}."
STOPPED = "Stopped. The best so far stays."
DRAWING_WORDS = "· rail   ⡇ link and its number   ▀ platform   : box of the postures"


def heading_text(machine: str, view: HexaSlideSeen | None) -> str:
    """Machine and procedure on one line."""
    if view is None:
        return machine
    kind = view.procedure.kind
    number = f"{KINDS.index(kind) + 1} of {len(KINDS)}" if view.published else "your own"
    return f"{machine}   {number}: {kind.value}"


def machine_words(path: Path | None) -> str:
    """The name of the machine file, or of the example."""
    return path.name if path else "example H60"


def problem_text(problem: Exception) -> str:
    """Why nothing is shown."""
    return wrapped(f"This machine or procedure cannot be used.\n\n{problem}")


def sees_text(
    view: HexaSlideSeen, found: BestPostures | None, best: dict[str, float] | None
) -> str:
    """Rank, what is lost, what is known, how many postures it takes; the paper beside it."""
    seen = view.seen
    rank, count = seen.found.rank, len(seen.found.names)
    published = seen.examined.published_rank
    paper = "" if published is None else f" (papers/001: {published})"
    parts = [
        wrapped(
            f"{PROCEDURE_WORDS[view.procedure.kind].capitalize()}: reads "
            f"{', '.join(seen.examined.measured)}.\n"
            f"IDENTIFIABLE: {rank} of {count} combinations of the parameters{paper}.\n"
            f"NOT IDENTIFIABLE by any posture: {lost_words(view)}.\n"
            f"FEWEST POSTURES: {view.fewest}."
        )
    ]
    if seen.examined.remark:
        parts.append(wrapped(seen.examined.remark))
    parts += [_conditions(view, found, best), wrapped(_known(view))]
    return "\n\n".join(parts)


def lost_words(view: HexaSlideSeen) -> str:
    """Motions of one frame in one breath; other combinations are long and only counted."""
    motions = {name for name, _ in view.seen.examined.sensitivity.motions}
    named = [one.name for one in view.seen.unidentifiable if one.name in motions]
    others = len(view.seen.unidentifiable) - len(named)
    said = [f"{motion} {', '.join(axes)}" for motion, axes in grouped(named).items()]
    if others:
        said.append(f"{others} other combination{'s' if others > 1 else ''}")
    return "; ".join(said) or "nothing"


def _known(view: HexaSlideSeen) -> str:
    known = view.seen.found.individually_known
    if len(known) == len(view.seen.found.names):
        return f"KNOWN ONE BY ONE: all {len(known)} parameters."
    return f"KNOWN ONE BY ONE ({len(known)}): {', '.join(known) or 'none'}."


def _conditions(
    view: HexaSlideSeen, found: BestPostures | None, best: dict[str, float] | None
) -> str:
    """Condition numbers in each unit, the paper's below."""
    table = new_table("condition number", *view.conditions)
    count = view.seen.examined.posture_count
    table.add_row(f"{count} random postures", *map(_number, view.conditions.values()))
    if found is not None and best is not None:
        start = found.start_condition_number
        table.add_row(f"{len(found.begin)} random, the start of the search", _number(start))
        table.add_row(f"{len(found.begin)} optimum postures", *map(_number, best.values()))
    published = view.published
    if published is not None:
        table.add_row(f"papers/001: {published.count} random", _number(published.random))
        table.add_row(f"papers/001: {published.count} optimum", _number(published.best))
    note = "Columns not scaled, so the number depends on the units."
    return f"{table_text(table)}\n{note}"


def _number(value: float) -> str:
    return f"{value:,.0f}".replace(",", " ") if value >= 1000.0 else f"{value:.1f}"


def search_text(
    view: HexaSlideSeen, count: int, found: BestPostures | None, *, searching: bool
) -> str:
    """How the search stands, in one or two lines."""
    if found is None:
        waiting = f"Searching for {count} postures, the first start …  Escape stops."
        return waiting if searching else f"{NOT_YET} Now {count} of them; C changes that."
    share = found.refined.on_bound / found.refined.coordinates.size
    said = (
        f"{len(found.begin)} postures, start {len(found.values)} of {found.search.starts}: "
        f"condition number {_number(found.start_condition_number)} → "
        f"{_number(found.condition_number)} (m, rad)"
        f"{_beside(view.published)}; {share:.0%} of the coordinates on a bound."
    )
    return wrapped(f"{said} Escape stops." if searching else said)


def _beside(published: PublishedSet | None) -> str:
    return "" if published is None else f", papers/001 {_number(published.best)}"


def list_text(found: BestPostures | None) -> str:
    """The best postures as a table."""
    if found is None:
        return NOT_YET
    return postures_table(found.coordinates)


def postures_table(postures: FloatArray) -> str:
    """Postures ``(p, 6)`` in metres and degrees."""
    table = new_table("", *COORDINATES)
    for number, posture in enumerate(postures.tolist(), start=1):
        places = (f"{value + 0.0:.4f}" for value in posture[:3])
        angles = (f"{math.degrees(value) + 0.0:.2f}" for value in posture[3:])
        table.add_row(f"{number}", *places, *angles)
    return table_text(table)


def drawn_at_text(number: int, count: int) -> str:
    """At which posture the machine is drawn."""
    where = "the middle of the box" if number == 0 else f"optimum posture {number} of {count}"
    turn = "" if count == 0 else "   + and - draw the others"
    return f"Drawn at {where}.{turn}\n{DRAWING_WORDS}"


def count_question(fewest: int) -> str:
    """Asked for the number of postures."""
    return f"How many postures? {fewest} or more."


def count_problem(found: str, fewest: int, most: int) -> str:
    """A number that is none, too small or too large."""
    return f"number of postures: found '{found}'; allowed: {fewest} to {most}"


def copied_text(text: str) -> str:
    """How much went to the clipboard."""
    return f"Copied: {len(text.splitlines())} lines"
