"""How the rails lie to each other, and what to move them by, in words."""

from __future__ import annotations

from app.measuring.aligning import RailAlignment, Round, Watch
from app.report.text.tables import new_table, paragraphs, signed, uncertain
from calib.arrays import LEG_NAMES
from calib.tripod.alignment import Shim
from calib.tripod.effects.effect import AROUND, PAIRS
from protocols.session import Changed

SQUARE = (
    "Positive: less than a right angle; the first axis, in the order x y z x, lies further along "
    "the third."
)
AS_THE_FILE = (
    "Both are from the drives of the machine file. Positive: a smaller angle; the first axis, in "
    "the order x y z x, lies further along what is across both."
)
UNSEEN = (
    "Leg readings do not show which axis of a pair leans or lies aside, only how both lie to each "
    "other: rail {} is the reference and stays (--reference)."
)
SOMETHING_ELSE = (
    "WARNING: something else acts on the readings, so the figures can be off by more than their ±. "
    "Look first: glidecal diagnose."
)


def aligned_text(aligned: RailAlignment) -> str:
    """How the rails lie to each other, from what they are to be; then the moves."""
    figure, half, off = (
        aligned.alignment,
        aligned.alignment.expanded.tolist(),
        aligned.alignment.off.tolist(),
    )
    square = aligned.alignment.to_square
    names = ("from square", "miss each other") if square else ("turned", "moved")
    figures = new_table("axes", f"{names[0]}, mrad", "±", f"{names[1]}, mm", "±", left_columns=1)
    by_pair = dict(zip(AROUND, zip(off[3:], half[3:], strict=True), strict=True))
    for k, pair in enumerate(PAIRS):
        mm, wide = by_pair[pair if pair in by_pair else pair[::-1]]
        lean = signed(off[k])
        figures.add_row(pair.upper(), lean, uncertain(half[k]), signed(mm), uncertain(wide))
    moves = new_table("move the end of", "at, mm", "towards", "by, mm", "±", "", left_columns=1)
    for shim in aligned.shims:
        fine = "" if shim.needed else "fine, leave it"
        moves.add_row(*_cells(shim), uncertain(shim.expanded_mm), fine)
    return paragraphs(
        figures,
        SQUARE if square else AS_THE_FILE,
        moves,
        "An end lies so far along its rail from where the axes meet; rails rest at rail_mm of the "
        "machine file. " + UNSEEN.format(aligned.reference.upper()),
        f"Left by the fit {figure.left_mm:.4f} mm r.m.s., noise of a reading "
        f"{figure.noise_mm:.4f} mm.",
        SOMETHING_ELSE if figure.lacks_something else "",
    )


def round_begins_text(aligned: RailAlignment) -> str:
    """What is to be known before a screw is turned."""
    return (
        SOMETHING_ELSE
        if aligned.alignment.lacks_something
        else UNSEEN.format(aligned.reference.upper())
    )


def lines_of_drives(name: str) -> tuple[str, ...]:
    """The comments above a machine file of drives as they lie."""
    return (
        f"The drives as glidecal align found them in {name}. Lengths in mm.",
        "For a controller that has them, as with glidecal export --format linuxcnc-kins.",
        "One that reckons with square drives needs the machine file from before.",
    )


def _cells(shim: Shim) -> tuple[str, str, str, str]:
    towards = f"{'+' if shim.move_mm >= 0.0 else '−'}{LEG_NAMES[shim.towards].upper()}"
    rail = f"rail {LEG_NAMES[shim.rail].upper()}"
    return rail, f"{shim.support_mm:.0f}", towards, f"{abs(shim.move_mm):.3f}"


def round_text(work: Round) -> str:
    """The list of screws, the chosen one marked; what is moved and what is to go.

    Both are positive in the direction that is asked for.
    """
    lines = ["  rail  end at  towards  by, mm    moved    to go"]
    live = work.live_mm()
    for k, shim in enumerate(work.aligned.shims):
        rail, at, towards, by = _cells(shim)
        is_watched = work.watching and k == work.number
        moved = live if is_watched else work.moved_mm.get(k)
        as_asked = is_watched or k in work.moved_mm
        moved_words, to_go = "as asked" if as_asked else "" if shim.needed else "fine", ""
        if as_asked and moved is not None:
            moved_words, to_go = signed(_asked_way(shim, moved)), _to_go(shim, moved)
        mark = ">" if k == work.number else "+" if k in work.moved_mm else " "
        lines.append(
            f"{mark} {rail[5:]:<5}{at:>4} mm  {towards:<8}{by:>7} {moved_words:>8} {to_go:>8}"
        )
    return "\n".join(lines)


def _asked_way(shim: Shim, along_mm: float) -> float:
    return along_mm if shim.move_mm >= 0.0 else -along_mm


def _to_go(shim: Shim, moved_mm: float) -> str:
    return signed(_asked_way(shim, shim.move_mm - moved_mm))


def screw_text(work: Round) -> str:
    """What to do at the chosen screw."""
    shim = work.shim
    rail, at, towards, by = _cells(shim)
    axis, leg = LEG_NAMES[shim.towards].upper(), LEG_NAMES[shim.rail].upper()
    along = work.station * work.aligned.machine.geometry().leg_length_mm[shim.rail]
    slope = signed(work.slope_mm())
    parallel = f"Leg {leg} at Zero: its foot {slope} mm along {axis} from its tool end."
    if work.watching:
        moved = work.live_mm()
        to_go = "nothing is shown" if moved is None else f"{_to_go(shim, moved)} mm to go"
        return (
            f"Turn: {rail}, {by} mm towards {towards} under the end at {at} mm. {to_go}.\n"
            f"{parallel}\n{{align.watch}} when it is there."
        )
    if not shim.needed:
        do = "As near as a turn would make it: leave it. {align.down}: the next one."
    elif not work.watchable:
        do = "No turn of this screw shows at Zero: turn it by the number, then {align.asked}."
    else:
        place = f"leg {leg} along {axis}, {along:.0f} mm from the tool end"
        do = f"Machine at Zero. Indicator on {place}; {{align.watch}}."
    move = f"R{rail[1:]}: {by} mm towards {towards} under the end at {at} mm."
    return f"{move}\n{parallel}\n{do}"


MOVE_QUESTION = (
    "From here on the machine is another one: what this round measured is not used any more, and "
    "every step is measured again. Move the rails now?"
)
MOVE_CHOICES = (("no", "No, not yet"), ("move", "Yes"))


WATCH = {
    Watch.BEGUN: "Watching. Turn this screw only.",
    Watch.BLIND: "WAIT: the indicator cannot show it. Turn it by the number, then {align.asked}.",
    Watch.DONE: "WAIT: it is done and in the record. {align.again} measures again.",
    Watch.NO_NUMBER: "WAIT: the indicator shows no number.",
}
IS_WATCHED = "WAIT: this screw is watched. {align.watch} when it is there, then the next."
WATCH_FIRST = "WAIT: {align.watch} watches the screw first."
NOTHING_MOVED = "Nothing was moved: the readings are valid. {align.finish} finishes."
MOVED_SINCE = "WAIT: something was moved since. {align.again} measures; {align.home} pauses."


def moved_text(change: Changed) -> str:
    """What to do after a move that is in the record."""
    along = (change.towards or "").upper()
    by = "as asked" if change.moved_mm is None else f"{change.moved_mm:+.3f} mm along {along}"
    rail = (change.rail or "").upper()
    return (
        f"In the record: end at {change.support_mm:.0f} mm of rail {rail}, {by}. "
        "The next one, or {align.again} measures again."
    )


def adjusted_words(name: str | None) -> str:
    """What belongs into the machine file after a change."""
    return f'Put adjusted = "{name}" into the machine file: earlier offsets are no longer valid.'
