"""Exit status of the program, as documented in docs/commands.md."""

from __future__ import annotations

from enum import IntEnum

from calib.errors import GlidecalError


class Exit(IntEnum):
    """0 done; 2 is also what typer itself uses for a wrong command line."""

    DONE = 0
    USAGE = 2
    RECORD = 3
    INDICATOR = 4
    RESULT = 5
    INTERRUPTED = 130


_BY_CLASS = {
    "UsageError": Exit.USAGE,
    "ImpossibleRequest": Exit.USAGE,
    "RecordError": Exit.RECORD,
    "IndicatorError": Exit.INDICATOR,
    "CalibrationError": Exit.RESULT,
}


def exit_code(problem: GlidecalError) -> Exit:
    """The status for an error; by class name, so that start-up imports none of the rooms."""
    for kind in type(problem).__mro__:
        if kind.__name__ in _BY_CLASS:
            return _BY_CLASS[kind.__name__]
    return Exit.RESULT
