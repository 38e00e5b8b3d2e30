"""Exit status of the program, as documented in docs/commands.md."""

from __future__ import annotations

from enum import IntEnum

from calib.errors import (
    GlidecalError,
    ImpossibleRequest,
    IndicatorError,
    MotionError,
    RecordError,
    UsageError,
)


class Exit(IntEnum):
    """0 done; 2 is also what typer itself uses for a wrong command line, 1 is Python's own."""

    DONE = 0
    USAGE = 2
    RECORD = 3
    INDICATOR = 4
    RESULT = 5
    FAILED = 6
    UNDECIDED = 7
    INTERRUPTED = 130


NOT_JUDGED = "not judged"
VERIFIED = {
    "pass": Exit.DONE,
    "fail": Exit.FAILED,
    "undecided": Exit.UNDECIDED,
    NOT_JUDGED: Exit.UNDECIDED,
}
"""By the decision of a verification; without a tolerance there is none."""

_STATUS = {
    UsageError: Exit.USAGE,
    ImpossibleRequest: Exit.USAGE,
    RecordError: Exit.RECORD,
    IndicatorError: Exit.INDICATOR,
    MotionError: Exit.INDICATOR,
}


def exit_code(problem: GlidecalError) -> Exit:
    """The status for an error."""
    return next((code for kind, code in _STATUS.items() if isinstance(problem, kind)), Exit.RESULT)
