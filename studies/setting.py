"""Draw how one leg is measured, for README: python -m studies.setting."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

TARGET = Path(__file__).parents[1] / "docs" / "pictures" / "setting.svg"
WIDTH, HEIGHT = 860, 450
ORIGIN = (400.0, 225.0)
"""Where the middle of the bar is in the picture."""

ALONG, TOWARDS = (0.97, -0.12), (0.50, 0.34)
"""Of a unit of X and of Y; Z goes up."""

Point = tuple[float, float, float]
INK, BAR, GAUGE, FAINT = "#222", "#1b6ca8", "#c8501e", "#9a9a9a"
HALF, APART = 165.0, 22.0
"""Half the bar's length, and half of what lies between its two rods."""

TABLE = -118.0


def at(point: Point) -> tuple[float, float]:
    """Where a place of the machine is in the picture."""
    x, y, z = point
    across = ORIGIN[0] + x * ALONG[0] - y * TOWARDS[0]
    return across, ORIGIN[1] + x * ALONG[1] + y * TOWARDS[1] - z


def line(
    points: Sequence[Point], colour: str = INK, width: float = 1.5, attributes: str = ""
) -> str:
    """A line through places."""
    drawn = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(at, points))
    return (
        f'<polyline points="{drawn}" fill="none" stroke="{colour}" stroke-width="{width}" '
        f'stroke-linejoin="round" stroke-linecap="round" {attributes}/>'
    )


def face(points: Sequence[Point], fill: str) -> str:
    """A surface."""
    drawn = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(at, points))
    return f'<polygon points="{drawn}" fill="{fill}" stroke="{INK}" stroke-width="1"/>'


def block(low: Point, high: Point, fill: str) -> list[str]:
    """A box: the three faces that are seen."""
    (a, b, c), (d, e, f) = low, high
    return [
        face([(a, e, c), (d, e, c), (d, e, f), (a, e, f)], fill),
        face([(d, b, c), (d, e, c), (d, e, f), (d, b, f)], fill),
        face([(a, b, f), (d, b, f), (d, e, f), (a, e, f)], "#fff"),
    ]


def words(
    where: Point | tuple[float, float], text: str, colour: str = INK, attributes: str = ""
) -> str:
    """Letters at a place of the machine or of the picture."""
    x, y = at(where) if len(where) == 3 else where
    return f'<text x="{x:.0f}" y="{y:.0f}" fill="{colour}" {attributes}>{text}</text>'


def gauge(tip: Point, towards: Point, name: str) -> list[str]:
    """An indicator: its spindle touches at the tip, its dial is where it comes from."""
    a, b, c = (end + 62.0 * part for end, part in zip(tip, towards, strict=True))
    x, y = at((a, b, c))
    return [
        line([tip, (a, b, c)], GAUGE, 4.0),
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="17" fill="#fff" stroke="{GAUGE}" stroke-width="3"/>',
        words((x, y + 5.0), name, GAUGE, 'text-anchor="middle" font-weight="bold"'),
    ]


def machine() -> list[str]:
    """Rail, carriage, the bar that is measured, the platform with the tool, the other bars."""
    end = HALF + 18.0
    drawn = [line([(-380.0, y, 0.0), (-HALF, y, 0.0)], FAINT, 3.0) for y in (-9.0, 9.0)]
    drawn += [line([(end, y, 8.0), (end + 70.0, y - 165.0, 24.0)], FAINT, 3.0) for y in (-8.0, 8.0)]
    drawn += [line([(end + x, 0.0, 14.0), (end + x, 0.0, 190.0)], FAINT, 3.0) for x in (-8.0, 8.0)]
    drawn += block((-HALF - 44.0, -30.0, -16.0), (-HALF, 30.0, 16.0), "#dfe7ee")
    drawn += [line([(-HALF, y, 0.0), (HALF, y, 0.0)], BAR, 6.0) for y in (-APART, APART)]
    drawn += block((HALF, -28.0, -14.0), (HALF + 36.0, 28.0, 14.0), "#dfe7ee")
    drawn += [line([(end, 0.0, -14.0), (end, 0.0, -62.0)], INK, 5.0)]
    return drawn


def stand() -> list[str]:
    """A foot on the table, a post, an arm, two indicators at the middle of the bar."""
    post = (0.0, 150.0)
    drawn = block((-32.0, 128.0, TABLE), (32.0, 178.0, TABLE + 24.0), "#e6e6e6")
    drawn += [line([(*post, TABLE + 24.0), (*post, 78.0)], INK, 5.0)]
    drawn += [line([(*post, 66.0), (0.0, APART, 66.0)], INK, 4.0)]
    drawn += [line([(*post, 0.0), (0.0, 96.0, 0.0)], INK, 4.0)]
    drawn += gauge((0.0, APART, 4.0), (0.0, 0.0, 1.0), "2")
    return drawn + gauge((0.0, APART + 4.0, 0.0), (0.0, 1.0, 0.0), "1")


def computer() -> list[str]:
    """What reads the indicators."""
    x, y = 34.0, 330.0
    screen = f'<rect x="{x}" y="{y}" width="150" height="86" rx="6" fill="#222"/>'
    base = f'<path d="M{x - 14} {y + 100} h178 l-14 -14 h-150 z" fill="#888"/>'
    digits = 'fill="#8fd18f" font-family="monospace" font-size="15"'
    cable = f'stroke="{GAUGE}" stroke-width="1.5" fill="none" stroke-dasharray="5 4"'
    first, two = at((0.0, APART + 66.0, 0.0)), at((0.0, APART, 66.0))
    return [
        f'<path d="M{first[0] - 17} {first[1]} C 270 330, 250 370, {x + 150} {y + 40}" {cable}/>',
        f'<path d="M{two[0] - 17} {two[1]} C 280 180, 270 350, {x + 150} {y + 22}" {cable}/>',
        screen,
        base,
        f'<text x="{x + 14}" y="{y + 34}" {digits}>1 Y  +0.173</text>',
        f'<text x="{x + 14}" y="{y + 60}" {digits}>2 Z  +0.411</text>',
    ]


def arrows() -> list[str]:
    """Where the machine goes, and what the words call what is seen."""
    head = 'marker-end="url(#head)" marker-start="url(#head)"'
    return [
        line([(-372.0, 0.0, 42.0), (-230.0, 0.0, 42.0)], INK, 2.0, head),
        words((24.0, 184.0), "the carriage goes"),
        words((24.0, 202.0), "Zero, Max, Min"),
        words((430.0, 250.0), "the bar of leg X", BAR),
        words((604.0, 268.0), "tool"),
        words((764.0, 116.0), "leg Y", FAINT),
        words((610.0, 40.0), "leg Z", FAINT),
        words((424.0, 318.0), "1 and 2: does the bar move across?", GAUGE),
        words((396.0, 366.0), "their stand stays where it is"),
    ]


def picture() -> str:
    """The whole drawing as SVG."""
    title = "One leg of an Orthoglide, two indicators on a stand at the middle of its bar"
    top = face(
        [(-90, -120, TABLE), (380, -120, TABLE), (380, 200, TABLE), (-90, 200, TABLE)], "#f4f4f4"
    )
    head = (
        '<defs><marker id="head" markerWidth="7" markerHeight="7" refX="5" refY="3" '
        f'orient="auto-start-reverse"><path d="M0 0 L6 3 L0 6 z" fill="{INK}"/></marker></defs>'
    )
    begin = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" '
        f'font-family="DejaVu Sans, Verdana, sans-serif" font-size="14"><title>{title}</title>'
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#fff"/>'
    )
    parts = [begin, head, top, *machine(), *computer(), *stand(), *arrows(), "</svg>"]
    return "\n".join(parts) + "\n"


if __name__ == "__main__":
    TARGET.write_text(picture(), encoding="utf-8", newline="\n")
