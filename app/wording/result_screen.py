"""What the result screen says beside the result."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from app.exports.linuxcnc import UNKNOWN_HOME_OFFSET
from app.solving import Solved
from app.wording.result import comparison_sentence, solution_text

RESULT_HELP = """\
1 2 3         joint offsets, leg lengths, or both
4             both, held by the tolerances of the parts
Tab, arrows   Result, Plot, and after a verification Before/after
E             write the joint offsets, in every format, into a folder
              beside the session
V             measure again after the offsets were entered, and compare
D             diagnose: where readings and model disagree, what is missing
Y             copy the text to the clipboard
H, F10        home, quit

U is the expanded uncertainty (95 %) of a parameter, from the noise of
the readings alone. Left is what the model does not explain: where it is
much larger than the noise, something is missing from the model."""

NEXT = (
    "Next: E exports the joint offsets. Enter them in the controller, then V measures again "
    "and compares."
)
ONLY_SHOWN = "This program only shows: nothing is written and nothing is measured."
NO_PLAN = "Verify is offered right after a session was measured."


def result_text(solved: Solved, before: Solved | None, *, measured_here: bool) -> str:
    """The text of the result; what to do next, or what the verification says, stands first."""
    if before is not None:
        first = comparison_sentence(before.solution, solved.solution) + "\n\n"
    else:
        first = NEXT + "\n\n" if measured_here else ""
    return first + solution_text(solved)


def exported_text(folder: Path, paths: Sequence[Path], solved: Solved) -> str:
    """What was written where, and what could not be known."""
    said = f"Written to {folder}: {', '.join(path.name for path in paths)}"
    if solved.sessions[0].opened.machine.home_offset_mm is None:
        said += ". WARNING: " + UNKNOWN_HOME_OFFSET
    return said


def copied_text(text: str) -> str:
    """How much was copied, and why it may not arrive."""
    return (
        f"{len(text.splitlines())} lines copied. If nothing arrives: some terminals do not allow "
        "it, and tmux needs `set-clipboard on`."
    )
