"""Draw and list the states of a machine that moves, for docs/motion.md: python -m studies.motion.

Which arrows there are and what they are called `drivers.motion.states` tells; here is only where.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap
from typing import Literal
from xml.sax.saxutils import escape

from drivers.motion.states import MAY_MOVE, TRANSITIONS, Cause, State

DOCS = Path(__file__).parents[1] / "docs"
TARGET, PAGE = DOCS / "pictures" / "motion.svg", DOCS / "motion.md"
BEGIN, END = "<!-- rows: python -m studies.motion -->\n", "<!-- end of rows -->\n"
WIDTH, HEIGHT = 1330, 775
BOX_WIDE, BOX_HIGH, ROUND = 132.0, 50.0, 10.0
LINE = 19.0
"""Between two lines of a label."""

INK, FAINT = "#222", "#777"
FILLS = {"rest": "#d6e6f2", "moves": "#f7c9c0", "answer": "#fbe7b2", "off": "#ececec"}
LEGEND = (
    ("rest", "at rest; only the operator's consent (key G) lets it move"),
    ("moves", "may move; every key stops it"),
    ("answer", "at rest; waits for the operator's answer"),
)

Point = tuple[float, float]
Anchor = Literal["start", "middle", "end"]

PLACES: dict[State, Point] = {
    State.OFF: (90, 330),
    State.READY: (470, 330),
    State.CONSENTED: (820, 330),
    State.MOVING: (1160, 330),
    State.STOPPING: (1160, 590),
    State.STOPPED: (820, 590),
    State.HELD: (470, 90),
    State.FAULT: (470, 590),
}


@dataclass(frozen=True)
class Arrow:
    """Where an arrow goes, where the first line of its label stands, and how long one may be."""

    points: tuple[Point, ...]
    label: Point
    anchor: Anchor = "middle"
    letters: int = 22


ARROWS: dict[tuple[State, State], Arrow] = {
    (State.OFF, State.READY): Arrow(((156, 330), (404, 330)), (228, 266), letters=14),
    (State.OFF, State.FAULT): Arrow(((90, 355), (90, 602), (404, 602)), (100, 470), "start"),
    (State.READY, State.HELD): Arrow(((440, 305), (440, 115)), (430, 194), "end", 14),
    (State.HELD, State.READY): Arrow(((500, 115), (500, 305)), (510, 196), "start", 14),
    (State.READY, State.FAULT): Arrow(((440, 355), (440, 565)), (430, 470), "end"),
    (State.FAULT, State.READY): Arrow(((500, 565), (500, 355)), (510, 412), "start", 14),
    (State.HELD, State.FAULT): Arrow(
        ((404, 90), (300, 90), (300, 580), (404, 580)), (290, 150), "end"
    ),
    (State.FAULT, State.FAULT): Arrow(((415, 615), (415, 650), (450, 650), (450, 615)), (432, 670)),
    (State.READY, State.CONSENTED): Arrow(((536, 318), (754, 318)), (629, 262)),
    (State.CONSENTED, State.READY): Arrow(((754, 342), (536, 342)), (626, 362)),
    (State.FAULT, State.CONSENTED): Arrow(((536, 578), (780, 355)), (606, 534), "start", 14),
    (State.STOPPED, State.CONSENTED): Arrow(((820, 565), (820, 355)), (830, 490), "start"),
    (State.CONSENTED, State.MOVING): Arrow(((886, 318), (1094, 318)), (990, 307)),
    (State.MOVING, State.CONSENTED): Arrow(((1094, 342), (886, 342)), (990, 362)),
    (State.CONSENTED, State.STOPPING): Arrow(((876, 355), (1110, 565)), (1034, 440), "start", 12),
    (State.MOVING, State.STOPPING): Arrow(((1160, 355), (1160, 565)), (1170, 440), "start", 12),
    (State.STOPPING, State.STOPPED): Arrow(((1094, 590), (886, 590)), (990, 612)),
    (State.STOPPING, State.HELD): Arrow(
        ((1226, 590), (1300, 590), (1300, 78), (536, 78)), (1000, 66), letters=40
    ),
    (State.STOPPING, State.FAULT): Arrow(
        ((1160, 615), (1160, 660), (490, 660), (490, 615)), (810, 682), letters=44
    ),
    (State.STOPPED, State.HELD): Arrow(
        ((754, 575), (724, 575), (724, 102), (536, 102)), (630, 124), letters=14
    ),
    (State.STOPPED, State.FAULT): Arrow(((754, 602), (536, 602)), (645, 622)),
}
CLOSED = Arrow(((90, 185), (90, 305)), (100, 250), "start")
EVERY: Point = (90, 160)
EVERY_STATE = "every state"


def pairs() -> dict[tuple[State, State], list[Cause]]:
    """The causes of each arrow that is drawn by itself: all but those from every state to one."""
    causes: dict[tuple[State, State], list[Cause]] = {}
    for (before, cause), after in TRANSITIONS.items():
        if cause is not Cause.CLOSED:
            causes.setdefault((before, after), []).append(cause)
    return causes


def fill_of(state: State) -> str:
    """The colour of a state: whether it may move, and who is waited for."""
    if state in MAY_MOVE:
        return FILLS["moves"]
    if (state, Cause.ANSWERED) in TRANSITIONS:
        return FILLS["answer"]
    return FILLS["rest"] if (state, Cause.CONSENT) in TRANSITIONS else FILLS["off"]


def box(middle: Point, name: str, fill: str, attributes: str = "") -> str:
    """A state."""
    x, y = middle
    return (
        f'<rect x="{x - BOX_WIDE / 2:.0f}" y="{y - BOX_HIGH / 2:.0f}" width="{BOX_WIDE:.0f}" '
        f'height="{BOX_HIGH:.0f}" rx="{ROUND:.0f}" fill="{fill}" stroke="{INK}" {attributes}/>'
        f'<text x="{x:.0f}" y="{y + 6:.0f}" text-anchor="middle" font-weight="bold" '
        f'font-size="17">{name}</text>'
    )


def line(points: tuple[Point, ...], attributes: str = "") -> str:
    """An arrow with round corners."""
    drawn = f"M{points[0][0]:.0f} {points[0][1]:.0f}"
    for before, corner, after in zip(points, points[1:], points[2:], strict=False):
        (a, b), (c, d) = towards(corner, before), towards(corner, after)
        drawn += f" L{a:.0f} {b:.0f} Q{corner[0]:.0f} {corner[1]:.0f} {c:.0f} {d:.0f}"
    drawn += f" L{points[-1][0]:.0f} {points[-1][1]:.0f}"
    return f'<path d="{drawn}" fill="none" stroke="{INK}" marker-end="url(#head)" {attributes}/>'


def towards(corner: Point, end: Point) -> Point:
    """A little way from a corner to where its line ends."""
    across, down = end[0] - corner[0], end[1] - corner[1]
    share = min(ROUND, max(abs(across), abs(down)) / 2.0) / max(abs(across), abs(down))
    return corner[0] + share * across, corner[1] + share * down


def words(place: Point, lines: list[str], anchor: Anchor = "middle") -> list[str]:
    """Lines of a label, in white that leaves room among arrows."""
    x, y = place
    return [
        f'<text x="{x:.0f}" y="{y + LINE * row:.0f}" text-anchor="{anchor}" stroke="#fff" '
        f'stroke-width="4" paint-order="stroke">{escape(text)}</text>'
        for row, text in enumerate(lines)
    ]


def labels() -> list[str]:
    """What each arrow is called; causes that share one stand below each other."""
    drawn = []
    for (before, after), causes in pairs().items():
        arrow = ARROWS[before, after]
        names = [causes[0], *(f"or {cause}" for cause in causes[1:])]
        rows = [row for name in names for row in wrap(name, arrow.letters)]
        title = "; ".join(f"{before}, {cause}: {after}" for cause in causes)
        drawn += ["<g>", f"<title>{escape(title)}</title>"]
        drawn += [*words(arrow.label, rows, arrow.anchor), "</g>"]
    return drawn


def closed() -> list[str]:
    """The one arrow for the cause that ends every state."""
    rows = {state for (state, cause), after in TRANSITIONS.items() if cause is Cause.CLOSED}
    if rows != set(State):
        raise ValueError(f"closed: from {len(rows)} states, allowed: all {len(State)}")
    dashed = 'stroke-dasharray="5 4"'
    return [
        box(EVERY, EVERY_STATE, "#fff", dashed),
        line(CLOSED.points, dashed),
        *words(CLOSED.label, [Cause.CLOSED], CLOSED.anchor),
    ]


def legend() -> list[str]:
    """What the colours mean."""
    drawn, x = [], 30.0
    for name, meaning in LEGEND:
        drawn.append(
            f'<rect x="{x:.0f}" y="733" width="22" height="16" rx="4" fill="{FILLS[name]}" '
            f'stroke="{INK}"/><text x="{x + 30:.0f}" y="746" fill="{FAINT}">{meaning}</text>'
        )
        x += 80.0 + 8.6 * len(meaning)
    return drawn


def picture() -> str:
    """The whole drawing as SVG. Raises ValueError where an arrow has no place, or no row."""
    if pairs().keys() != ARROWS.keys() or set(PLACES) != set(State):
        changed = sorted(f"{a} → {b}" for a, b in pairs().keys() ^ ARROWS.keys())
        raise ValueError(f"arrows {', '.join(changed)}: allowed are those of TRANSITIONS")
    begin = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" '
        'font-family="DejaVu Sans, Verdana, sans-serif" font-size="16" stroke-width="1.4">'
        "<title>The states of a machine that a controller moves</title>"
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#fff"/>'
        '<defs><marker id="head" markerWidth="9" markerHeight="9" refX="8" refY="4" '
        f'orient="auto"><path d="M0 0 L8 4 L0 8 z" fill="{INK}"/></marker></defs>'
    )
    arrows = [line(arrow.points) for arrow in ARROWS.values()]
    boxes = [box(PLACES[state], state.upper(), fill_of(state)) for state in State]
    parts = [begin, *arrows, *boxes, *labels(), *closed(), *legend(), "</svg>"]
    return "\n".join(parts) + "\n"


OFF_TESTS = {
    Cause.CONNECTED: "test_a_connected_machine_is_ready_and_nothing_moves",
    Cause.FAILED: "test_start_where_only_homing_helps_begins_in_a_fault",
    Cause.CLOSED: "test_nothing_moves_where_the_machine_is_not_ready",
}


def test_of(before: State, cause: Cause) -> str:
    """The test of one row."""
    if before is State.OFF:
        return OFF_TESTS[cause]
    if cause is Cause.CLOSED:
        return f"test_closed_from_every_state[{before}]"
    return f"test_each_row_of_the_table[{before}, {cause}]"


def rows() -> str:
    """Every transition: a row for each cause, which leads to one state wherever it acts."""
    table = "| cause | state → next state |\n|---|---|\n"
    for cause in Cause:
        befores = [state for state in State if (state, cause) in TRANSITIONS]
        (after,) = {TRANSITIONS[before, cause] for before in befores}
        names = EVERY_STATE if befores == list(State) else ", ".join(befores)
        table += f"| {cause} | {names} → {after} |\n"
    return table


def page(text: str) -> str:
    """A page with the rows of now between its two marks."""
    before, after = text.split(BEGIN)
    return f"{before}{BEGIN}{rows()}{END}{after.split(END)[1]}"


if __name__ == "__main__":
    TARGET.write_text(picture(), encoding="utf-8", newline="\n")
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8", newline="\n")
