"""Sentences of docs/hexaslide.md, and how its tables are written."""

from __future__ import annotations

import os
from collections.abc import Sequence
from textwrap import fill

THREADS = os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
"""As the program does, before numpy is imported: small matrices are slower on several cores."""

WIDTH = 98

INTRO = """\
# Hexa Slide

What a calibration procedure sees of a Hexa Slide's parameters, the postures that show most, and
the Tables 1 to 6 of papers/001 once more, corrected. This page is made by
`docs/make_hexaslide.py`; every number below comes from the program, those of the paper are marked
as its own.

    glidecal identifiability hexaslide --procedure position
    glidecal identifiability hexaslide --procedure position --screen
    glidecal identifiability hexaslide --procedure pose-forward --measured x,y,z,theta
    glidecal postures hexaslide --procedure pose-inverse --count 9 --criterion condition

![The machine drawn at the middle of its box](pictures/hexaslide.svg)

The geometry of the paper's machine is not known. H60 (`protocols/machines/hexaslide-h60.toml`) is
an assumed one that fits what the paper tells: its frames, its box, six equal links, rails that
are not level. Ranks do not depend on that choice, but for special geometries; condition numbers
do, so digits need not agree with the paper's.

## What is seen: Table 1"""

RANKS = """\
**Position.** All joints of the platform may be turned together about its origin: the sliders then
stand as before and so does the origin. Three turns are lost, no more. The rails, their starts and
the links stay known one by one; only the joints are known but for that turn. A noise-free
calibration leaves no error of position anywhere, only one constant turn of the platform.

**Constraint link.** The length between its ends does not change when the platform's frame is
turned or shifted with all that is fixed to it, nor when the base is turned about its X. The paper
fixes that turn by gravity, but nothing that is read here feels gravity. Seven motions are lost,
48 combinations stay.

So the paper's 48 and 46 are too many for the one and too few for the other. They are the true
numbers exchanged, and they are its numbers of rows as well, 16 × 3 and 46 × 1:"""

ROW_COUNTS = """\
Rows limit the rank, they do not show it: with 16 postures 48 rows give rank 46, with 46 postures
46 rows hide two of the 48. For pose-inverse the rule of the paper, as many rows as parameters,
asks for 9 postures by luck: the true reason is that each chain has up to nine parameters and one
row a posture.

The paper takes differences with a step of 1e-7 and calls a diagonal entry of R zero below r · ε ·
max |r_ii|, about 1e-13. Differences are wrong by 1e-9 to 1e-7 themselves, so nothing ever falls
below, and that recipe counts rows or columns, whichever are fewer:"""

RECIPE = """\
With exact derivatives the last singular value that is seen is so many times larger than the next
one, as the last column says, that the rank is no matter of opinion. Which way the paper came to
its numbers cannot be told from its text."""

BOX = """\
## Where postures may be: Table 2"""

BOX_NOTE = """\
Every machine file is checked to reach all of its box. Postures for the constraint link are free
in the box; they need not keep its length. The rank is the same if they do."""

CONDITIONS = """\
## Random and optimum postures: Tables 3 to 6

Condition numbers of what is seen: largest by smallest singular value that counts, metres and
radians, columns not scaled. {sets} random sets, {starts} starts of the search, seed {seed}."""

UNITS = """\
The paper's "boundary" holds in this sense: nearly every posture has a coordinate on a bound. It
does not hold as "corners": many coordinates stand inside, and hardly a posture is a corner.

Its small gains for position and constraint link were the limit of its search. Exact gradients and
a condition number made smooth at first reach factors of tens to a hundred for all four. The
paper's random figures are high because the number of postures is the fewest possible; that of
position lies above the range found here, that of the constraint link above what 46 postures give,
and how many singular values it counted there is not told. Its order of the four procedures is no
property of them: here position comes before pose-forward.

## Units

A condition number of columns that are not scaled changes with the units, because components of a
rail's direction have none and links have one. The paper calls the matrices of pose-inverse and
position homogeneous; they are not. The same postures:"""

MORE = """\
So a condition number says nothing without its units, and compares procedures only within one
choice.

## More postures

{starts} starts beyond the fewest, so a longer row may be worse than it need be."""

SUBSETS = """\
A few postures above the fewest help most where the fewest leave nothing over.

## Any measured components

Any part of the posture can be measured: `--measured` on the command line, M on the screen. A tilt
beside the position gives two of the three lost turns back. The third, about the platform's Z,
shows in phi alone, so a second tilt adds nothing to it:"""

SETS = """\
## The posture sets

The best set for each procedure, as `glidecal postures hexaslide --json` gives it too."""

OWN = """\
## A geometry of your own

One file holds a machine: copy `protocols/machines/hexaslide-h60.toml`, change it, name it with
`--machine-file`.

| key | what |
|---|---|
| `[[chain]]`, six times | |
| `start_m` | where the rail starts, base frame |
| `rail` | a unit vector along it, not level |
| `joint_m` | the joint on the platform, platform frame |
| `link_m` | length of the link |
| `[box]` | bounds of the postures, metres and degrees |
| `[constraint_link]` | its two ends and its length; only for the procedure of that name |

The base frame begins at the first rail and its X goes through the start of the second, so those
two begin `[0, 0, 0]` and `[x, 0, 0]`. A link that cannot reach its rail somewhere in the box, a
rail that is no unit vector, a frame of another kind: each is refused with its line.

    glidecal identifiability hexaslide --procedure position --machine-file mine.toml --screen
    glidecal postures hexaslide --procedure position --count 20 --machine-file mine.toml
    python docs/make_hexaslide.py --machine-file mine.toml --output mine.md

The last line makes this page for that machine."""

SIMULATED = """\
## A simulated calibration

A machine with normal errors of 1 mm in every length and 1 mm in 1 m in every direction is hidden
behind the nominal one, 80 random postures are measured with a noise of 0.01 mm and 0.01 mrad, and
the parameters are identified from four fifths of them or more.

    glidecal simulate -o measured.json --machine hexaslide --procedure position --postures 80 \\
        --truth true.json
    glidecal solve measured.json --truth true.json

The errors at postures kept out, against the true machine, before and after; motions of whole
frames that nothing shows are taken out first and stand in the last column."""

SIMULATED_NOTE = """\
What is lost does not harm what is seen: with position alone the platform's origin is found as
well as its readings allow. The constraint link, with few rows more than combinations and a large
condition number, turns the same noise into far larger errors."""


def table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [headings, ["---"] * len(headings), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def filled(text: str) -> str:
    """One paragraph in lines."""
    return fill(text, WIDTH, break_on_hyphens=False, break_long_words=False)


def code(text: str) -> str:
    """Lines as they are."""
    return "\n".join(f"    {line}".rstrip() for line in text.splitlines())


def number(value: float) -> str:
    """About four digits."""
    if value < 1000.0:
        return f"{value:.1f}"
    return f"{value:.0f}" if value < 10_000.0 else f"{value:.3e}".replace("e+0", "e")
