"""What home, the form before a session and the check of indicators say; settings and keys."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from app.measuring.recent import Recent
from app.report.text.tables import new_table, table_text
from app.settings import FILE_VARIABLE, Settings

WORDS_OF_LOOKS = "{looks}"
"""Where the help has the lines of the machines' own screens."""

HOME_HELP = f"""\
Continue       an interrupted session, at its first open step
New session    measures with real indicators
Demonstration  the same on a simulated machine, in demo-sessions
Compare        the session before the offsets were entered in the
               controller with the one after
Diagnose       where readings and model disagree, and what is missing
{WORDS_OF_LOOKS}

Sessions of this folder and of demo-sessions stand below, newest
first. Enter on one of them offers what can be done with it.
Ctrl+P opens the command palette: theme, keys, screenshot."""

HOME_QUESTION = "What do you want to do? Arrow keys and Enter."
COMPUTING = "Computing … F10 leaves."

HOME_CHOICES = (
    ("new", "New session on real indicators"),
    ("demo", "Demonstration on a simulated machine"),
    ("result", "Result of a session"),
    ("replay", "Replay a session"),
    ("compare", "Compare before and after"),
    ("export", "Export offsets of a session"),
    ("diagnose", "Diagnose: what is missing in the model"),
)
READING_ONLY = ("result", "replay", "compare", "diagnose")
"""What is left where nothing may be written."""

WHICH = {
    "result": "The result of which session?",
    "replay": "Replay which session?",
    "export": "Export the joint offsets of which session?",
    "diagnose": "Diagnose which session?",
    "before": "Which session is the one BEFORE the offsets were entered?",
    "after": "Which session is the one AFTER the offsets were entered?",
}
NO_SESSIONS = "No session files in this folder or in demo-sessions."
ELSEWHERE = "A session in another place: type its path"
PICK_KEYS = "Arrow keys and Enter. Escape goes back."


def session_label(session: Recent) -> str:
    """Path and state on two lines."""
    verifies = f", verifies {session.verifies}" if session.verifies else ""
    return f"{session.path}\n    {session.state}{verifies}"


def session_choices(session: Recent, *, read_only: bool) -> list[tuple[str, str]]:
    """What can be done with a session: answers and words for a dialog."""
    able = [
        ("continue", "Continue measuring"),
        ("result", "Result"),
        ("replay", "Replay"),
        ("export", "Export the joint offsets"),
        ("compare", "Compare before and after"),
        ("diagnose", "Diagnose"),
    ]
    if read_only:
        able = [pair for pair in able if pair[0] in READING_ONLY]
    elif not session.interrupted:
        able = able[1:]
    return [(name, f"{number}  {words}") for number, (name, words) in enumerate(able, start=1)]


def partner_question(after: Path, before: Path) -> str:
    """A session names the one that it verifies."""
    return f"{after.name}\nwas measured to verify\n{before.name}"


PORTS_QUESTION = "The ports of {} are those of another computer. Which are they here?"
PORTS_HINT = "mitutoyo-01a:COM5@yx sylvac:COM6@zy, with the axes as before"

REPLACE_CHOICES = (("keep", "1  Keep what is there"), ("replace", "2  Replace it"))

PARTNER_CHOICES = (
    ("both", "1  Compare these two"),
    ("other", "2  Another session after this one"),
)


PREPARE_HELP = """\
F5  opens the indicators and shows them live; nothing is recorded yet
F2  shows every step of the procedure; opens and writes nothing
Tab, Enter  the next field. The last lines tell steps and time."""

FIELD_HELP = {
    "procedure": "Procedure: what is measured, in which order. Enter opens the list.",
    "indicator1": (
        "First indicator: PROFILE:PORT, with @ and axes where it cannot\n"
        "measure along all of them. glidecal ports lists profiles and ports.\n"
        "Empty: the indicators of the machine file."
    ),
    "indicator2": "Second indicator. With one alone each leg is measured twice.",
    "machine": "Machine file: TOML. Without one, the prototype of the papers.",
    "operator": "Operator: a name for the record.",
    "temperature": "Temperature of the machine for the record, in °C.",
    "random": (
        "Random order seed: shuffles the levels after Zero in each cycle, so\n"
        "that drift does not look like displacement. One seed gives one order.\n"
        "Only a procedure whose order is free allows it."
    ),
}
"""Words of F1 for each field of the form."""

CHECK_HELP = """\
Move each spindle by hand: the right display must follow, in mm, with the
right sign. Nothing is recorded before Enter. A panel that shows a fault
tells its kind; glidecal indicator doctor examines it."""

KeyRow = tuple[str, Sequence[str], str]
"""Id of a binding, its keys without settings, what it does."""


def settings_text(path: Path, exists: bool, settings: Settings, keys: Iterable[KeyRow]) -> str:
    """Where the file is, what holds now, and every key that can be changed."""
    state = "" if exists else " (not there yet: everything has its default)"
    lines = [
        f"Settings file: {path}{state}",
        f"{FILE_VARIABLE} names another file.",
        "",
        f"theme       {settings.theme or 'default'}",
        f"animations  {'on' if settings.animations else 'off'}",
        "",
        'Keys; under [keys] a line such as "measure.take" = "space,f2" changes them:',
    ]
    table = new_table("id", "default", "now", "does", left=4)
    for key_id, default, words in keys:
        table.add_row(key_id, ", ".join(default), settings.keys.get(key_id, ""), words)
    return "\n".join(lines) + "\n\n" + table_text(table)


def key_list_text(keys: Iterable[tuple[str, str]]) -> str:
    """The keys of the present screen, one a line."""
    rows = [f"{key:<12}{words}" for key, words in keys]
    return "Keys of this screen\n\n" + "\n".join(rows)
