"""What home, the form before a session and the check of indicators say; settings and keys."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from app.measuring.indicators import indicator_of, port_is_gone
from app.measuring.recorded import MOST_LISTED, SessionFile
from app.report.text.tables import new_table, paragraphs
from app.settings import FILE_VARIABLE, Settings
from calib.errors import GlidecalError
from drivers.profile import Evidence, Profile
from drivers.profiles import PROFILES
from protocols.machine_files import USUAL_MACHINE, machine_names

WORDS_OF_LOOKS = "{looks}"
"""Where the help has the lines of the machines' own screens."""

LIST_KEYS = "Arrow keys and Enter"
"""Of every list: Textual's own."""

ONLY_SHOWN = "This program only shows sessions: nothing is written and nothing is measured."
REPORTS_SERVED = "Reports to read and print: in the browser, add /reports to this address."
HISTORY_OF = "History of {}"
HOME_QUESTION = f"What do you want to do? {LIST_KEYS}."
COMPUTING = "Computing … {app.quit} leaves."

HOME_CHOICES = (
    ("new", "New session on real indicators"),
    ("demo", "Demonstration on a simulated machine"),
    ("result", "Result of a session"),
    ("replay", "Replay a session"),
    ("compare", "Compare before and after"),
    ("export", "Export offsets of a session"),
    ("diagnose", "Diagnose: what is missing in the model"),
    ("history", "History: sessions of this folder over time"),
)
READING_ONLY = ("result", "replay", "compare", "diagnose", "history")
"""What is left where nothing may be written."""

WHICH = {
    "result": "The result of which session?",
    "replay": "Replay which session?",
    "export": "Export the joint offsets of which session?",
    "diagnose": "Diagnose which session?",
    "before": "Which session is the one BEFORE the offsets were entered?",
    "after": "Which session is the one AFTER the offsets were entered?",
}
NO_COMPARISON = (
    "Sessions of postures are compared by glidecal verify BEFORE AFTER, or in a report with "
    "--after."
)
NO_SESSIONS = "No session files in this folder or in demo-sessions."
ELSEWHERE = "A session in another place: type its path"
WHICH_PATH = "Type the path of a session file."
REPLAY_CHOICE_HELP = f"""\
{LIST_KEYS} open a session.
For a folder: the newest {MOST_LISTED} sessions, and its history."""


def session_label(session: SessionFile) -> str:
    """Path and state on two lines."""
    verifies = f", verifies {session.verifies}" if session.verifies else ""
    return f"{session.path}\n    {session.state}{verifies}"


ListRow = tuple[str, str]
"""Words of a row, and what it stands for: an answer, and the path that it is about."""


def home_rows(
    sessions: Sequence[SessionFile], own_screens: Iterable[ListRow], *, read_only: bool
) -> Iterator[ListRow | None]:
    """What home offers, interrupted sessions first; None is a line between.

    ``own_screens`` of machines have a name and words.
    """
    labels = [(session, session_label(session)) for session in sessions]
    for session, label in labels:
        if session.interrupted and not session.empty and not read_only:
            yield f"Continue  {label}", f"continue {session.path}"
    for name, choice in (*HOME_CHOICES, *own_screens):
        if not read_only or name in READING_ONLY:
            yield choice, name
    if labels:
        yield None
    yield from ((label, f"session {session.path}") for session, label in labels)


def replay_question(*, served: bool) -> str:
    """Above a list of sessions; where they are served to others, so are their reports."""
    question = f"Which session do you want to see? {LIST_KEYS}."
    return f"{question}\n{REPORTS_SERVED}" if served else question


def replay_rows(folders: Sequence[Path], sessions: Sequence[SessionFile]) -> Iterator[ListRow]:
    """The histories of these folders, then these sessions."""
    yield from ((HISTORY_OF.format(folder.name), f"history {folder}") for folder in folders)
    yield from ((session_label(session), f"replay {session.path}") for session in sessions)


POSTURE_CHOICES = (
    ("result", "Result; export and report"),
    ("diagnose", "Diagnosis"),
    ("replay", "Readings"),
)


def session_choices(session: SessionFile, *, read_only: bool) -> list[tuple[str, str]]:
    """What can be done with a session: answers and words for a dialog."""
    if session.own_form:
        return list(POSTURE_CHOICES)
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
    return able


def partner_question(later_path: Path, earlier_path: Path) -> str:
    """A session names the one that it verifies."""
    return f"{later_path.name}\nwas measured to verify\n{earlier_path.name}"


PORTS_QUESTION = "The ports of {} are those of another computer. Which are they here?"
PORT_HINT = "/dev/ttyUSB0, COM5, socket://HOST:PORT"
PORTS_HINT = "mitutoyo-01a:COM5@yx sylvac:COM6@zy, with the axes as before"

REPLACE_CHOICES = (("keep", "Keep what is there"), ("replace", "Replace it"))

PARTNER_CHOICES = (
    ("both", "Compare these two"),
    ("other", "Another session after this one"),
)


class FormField(NamedTuple):
    """A line of a form to type into, or with ``rows`` of words and value a list to choose from."""

    name: str
    label: str
    hint: str = ""
    value: str = ""
    rows: Sequence[tuple[str, str]] | None = None


OTHERS = ", ".join(name for name in machine_names() if name != USUAL_MACHINE)
WHICH_MACHINE = (
    FormField("machine", "Machine", f"empty: {USUAL_MACHINE}; or {OTHERS}, or a file"),
    FormField("serial", "Its serial number", "separates machines of one name in the history"),
    FormField("place", "Its place", "a hall or a room, for the history"),
)
WHICH_INDICATOR = (
    FormField("indicator1", "First indicator"),
    FormField("indicator2", "Second indicator"),
)
FIELDS = (
    FormField("operator", "Operator"),
    FormField("temperature", "Temperature, °C"),
    FormField("note", "Note", "shown below the result"),
    FormField("random", "Random order seed", "empty: the order as written"),
    FormField("motion", "Moved by", "empty: you; or linuxcnc:HOST:PORT, grbl:PORT"),
)

NO_INDICATOR = (
    "none yet: {prepare.choose} chooses",
    "none: each leg is measured twice. {prepare.choose} chooses",
)
NO_INDICATOR_AT_PLATE = (NO_INDICATOR[0], "none: one reads the tool. {prepare.choose} chooses")
SOURCES = {"": "", "file": ", of the machine file", "last": ", as last time"}
CHOOSE_INDICATOR = "Choose an indicator on its line. The demonstration needs none."
NOT_HERE = " (not plugged in)"

INDICATOR_FIELDS = (
    FormField("port", "Port", PORT_HINT),
    FormField("profile", "Profile", "choose, or let {indicator.try} try on this port"),
    FormField("axes", "Measures along"),
    FormField("unit", "Unit of the display"),
    FormField("channel", "Channel", "1, of an interface with several inputs"),
    FormField("serial_number", "Serial number"),
    FormField("certificate", "Certificate", "number of the calibration certificate"),
    FormField("certificate_date", "Date of certificate", "as 2026-01-31"),
)

TRY_HINT = "{indicator.try} tries which profiles fit at this port. Nothing is written to it before."
TRYING = "Trying profiles, up to a minute. {indicator.back} stops."
STOPPED = "Stopped before a profile fitted."
PORT_GONE = "Port {} is not here now: plug it in, or choose another one."


def form_problem(form: Mapping[str, object]) -> str:
    """What is wrong with what was typed of an indicator; what is still to be typed is not."""
    port = str(form.get("port", ""))
    try:
        if port and form.get("profile"):
            indicator_of(form)
    except GlidecalError as problem:
        return str(problem)
    return PORT_GONE.format(port) if port and port_is_gone(port) else ""


def ports_here(count: int) -> str:
    """What the list of ports says before one is chosen."""
    if not count:
        return "none found: plug one in and come back, or type it"
    return f"{count} port{'s' if count > 1 else ''} to choose from"


def port_label(port: str, description: str, names: Mapping[str, str]) -> str:
    """A port with what the system says of it, and what was found to answer there."""
    fits = f"; answers as {names[port]}" if port in names else ""
    return f"{port}  {description}{fits}"


def profile_rows(fitting: Sequence[Profile] = ()) -> list[tuple[str, str]]:
    """Words and name of each profile for a list, those that fit at the port first."""
    names = [profile.name for profile in fitting]
    other_profiles = [profile for profile in PROFILES.values() if profile.name not in names]
    rows = [(p.name, f"{p.title}{UNSURE[p.verified]}") for p in (*fitting, *other_profiles)]
    return [(f"{'fits: ' * (name in names)}{name}  {label}", name) for name, label in rows]


UNSURE = {Evidence.VENDOR: "", Evidence.CODE: "", Evidence.UNVERIFIED: " (unverified)"}


def axes_words(axes: str) -> str:
    """The directions that an indicator may measure along, preferred ones first."""
    if axes == "xyz":
        return "any direction"
    return f"{axes} only" if len(axes) == 1 else ", else ".join(axes)


def form_words(form: Mapping[str, object], source: str, *, missing: bool) -> str:
    """One line for an indicator of the form."""
    number = f", no. {form['serial_number']}" if form.get("serial_number") else ""
    axes = axes_words(str(form.get("axes", "xyz")))
    where = f"{form.get('port', 'no port')}{NOT_HERE if missing else ''}"
    return f"{form.get('profile', 'no profile')} at {where}, {axes}{number}{SOURCES[source]}"


WHICH_COMMAND = "What do you want to do?"
WHICH_THEME = "Which colours?"
PALETTE = (
    "Theme: Choose the colours; kept in the settings",
    "Screenshot: Save this screen as an SVG picture in the current folder",
    "Keys: Every key of this screen",
    "Quit: Leave; an open session is paused and can be continued",
)
TOO_SMALL = (
    "This window has {} × {} characters, and words are cut. glidecal needs {} × {}: make it larger."
)
NO_HELP = "The keys of this screen are in its last line."

KeyRow = tuple[str, Sequence[str], str]
"""Id of a binding, its keys without settings, what it does."""


def settings_text(path: Path, exists: bool, settings: Settings, keys: Iterable[KeyRow]) -> str:
    """Where the file is, what holds now, and every key that can be changed."""
    state = "" if exists else " (not there yet: everything has its default)"
    table = new_table("id", "default", "now", "does", left_columns=4)
    rows = [*keys]
    # an id is copied
    table.columns[0].min_width = max((len(key_id) for key_id, *_ in rows), default=0)
    for key_id, default, label in rows:
        table.add_row(key_id, ", ".join(default), settings.keys.get(key_id, ""), label)
    return paragraphs(
        [f"Settings file: {path}{state}", f"{FILE_VARIABLE} names another file."],
        f"theme       {settings.theme or 'default'}\n"
        f"animations  {'on' if settings.animations else 'off'}\n"
        f"laboratory  {settings.laboratory.name if settings.laboratory else 'none'}",
        'Keys; under [keys] a line such as "measure.take" = "space,f2" changes them:',
        table,
    )


KEY_WORDS = {"comma": ",", "plus": "+", "minus": "-", "pageup": "page up", "pagedown": "page down"}


def key_words(key: str) -> str:
    """A key as a person calls it: ``Space``, ``F2``, ``Ctrl+T``."""
    parts = (KEY_WORDS.get(part, part) for part in key.split("+"))
    return "+".join(part.upper() if len(part) == 1 else part.capitalize() for part in parts)


def key_list_text(keys: Iterable[tuple[str, str]]) -> str:
    """The keys of the present screen that have words, one a line."""
    return paragraphs("Keys of this screen", [f"{key:<12}{label}" for key, label in keys if label])


def help_text(helps: Iterable[str], of_machines: Iterable[str]) -> str:
    """The ``helps`` of panels and screen, each once, with those of the machines' own screens."""
    text = "\n\n".join(dict.fromkeys(filter(None, helps)))
    return text.replace(WORDS_OF_LOOKS, "\n".join(of_machines)) or NO_HELP
