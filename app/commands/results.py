"""``glidecal solve``, ``compare`` and ``export``: from sessions to parameters and offsets."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from app.machines.options import (
    Answer,
    AsJson,
    Force,
    FrameName,
    Method,
    Output,
    Sessions,
    SubsetName,
    argument,
    deliver,
    file,
    may_deliver,
    may_replace,
    number,
    option,
    say,
    tell_warnings,
    working,
)
from app.machines.registry import (
    LOOKS,
    NAMES_OF_FILES,
    family_of_files,
    options_of,
    the_session,
    with_options_of_machines,
)
from calib.errors import UsageError, extra

if TYPE_CHECKING:  # heavy: imported where used
    from app.evaluating.solution import TableName
    from app.report.pages.report import ReportSource
    from protocols.data_table import DataTable

PASSWORD_VARIABLE = "GLIDECAL_KEY_PASSWORD"
"""Environment variable with the password of the key that signs."""

Tolerance = Annotated[
    float | None, number("Tolerance of the tool error, mm r.m.s.; default: the machine file's.")
]


@with_options_of_machines
def solve(
    context: typer.Context,
    sessions: Sessions,
    machine: Annotated[
        str | None, option(f"{', '.join(NAMES_OF_FILES)}; default: by the file.")
    ] = None,
    as_json: AsJson = False,
    **machine_options: Any,  # noqa: ANN401 (what the machines add)
) -> None:
    """Values to enter, their uncertainty, the tool error. Then parameters and residuals."""
    family = family_of_files(machine, sessions)
    options = options_of(
        context,
        family,
        family.measured,
        machine_options,
        lambda family_beside: family_beside.measured,
    )
    family.solve(sessions, **options).show(as_json=as_json)


def compare(
    before: Annotated[Path, argument("Session before.")],
    after: Annotated[Path, argument("Session after.")],
    as_json: AsJson = False,
) -> None:
    """The differences before and after a calibration. After: with the offsets entered."""
    if (verbs := family_of_files(None, [before, after]).sessions) is not None:
        verbs.compared(before, after).show(as_json=as_json)
        return
    from app.evaluating.comparison import compare_files
    from app.report.schema.solution import ComparisonReport
    from app.report.text.result import comparison_report

    comparison = compare_files(before, after)
    Answer(comparison, comparison_report, ComparisonReport.of).show(as_json=as_json)


def verify(
    before: Annotated[Path, argument("Session before.")],
    after: Annotated[Path, argument("Session with the offsets entered.")],
    tolerance: Tolerance = None,
    as_json: AsJson = False,
) -> None:
    """Were the offsets entered, is the tool in tolerance?

    Exit 0: pass, 6: fail, 7: undecided.
    """
    from app.evaluating.comparison import verify_files
    from app.exit_codes import NOT_JUDGED, VERIFIED
    from app.report.schema.solution import VerificationReport
    from app.report.text.result import decided, verification_text

    verbs = family_of_files(None, [before, after]).sessions
    if verbs is not None:
        answer, decision = verbs.verified(before, after, tolerance)
        words = decision
    else:
        verification = verify_files(before, after, tolerance)
        answer = Answer(verification, verification_text, VerificationReport.of)
        decision, words = verification.decision or NOT_JUDGED, decided(verification)
    answer.show(as_json=as_json)
    if decision != "pass":
        say(f"glidecal: the verification did not pass: {words}")
    raise typer.Exit(VERIFIED[decision])


OF_INDICATORS = (
    *("table", "subset", "method", "model"),
    *("home_offset", "endstops", "ini", "frame"),
)


def export(
    context: typer.Context,
    sources: Annotated[list[Path], argument("Sessions of one machine, or a model file.")],
    output: Output,
    format_name: Annotated[
        Literal[
            "json",
            "csv",
            "model",
            "linuxcnc",
            "linuxcnc-kins",
            "lineardeltakins",
            "klipper",
            "reprapfirmware",
            "marlin",
            "smoothieware",
            "p-3z",
            "ros2",
            "xlsx",
            "parquet",
        ],
        option(
            "json, csv, model, linuxcnc, linuxcnc-kins, lineardeltakins, klipper, "
            "reprapfirmware, marlin, smoothieware, p-3z; of postures ros2; tables: csv, xlsx, "
            "parquet.",
            "--format",
            metavar="NAME",
        ),
    ],
    table: Annotated[
        Literal["readings", "differences", "residuals"] | None,
        option(
            "A table instead: readings (what import reads), differences or residuals.",
            show_default="readings for xlsx and parquet",
        ),
    ] = None,
    subset: Annotated[
        SubsetName | None, option("Write this set of parameters as identified, not the correction.")
    ] = None,
    method: Method = "exact",
    model: Annotated[
        Path | None, file("Of a session: fit the sizes of this model's effects, too.", to_read=True)
    ] = None,
    home_offset: Annotated[
        str | None, option("Present HOME_OFFSET of the joints of x,y,z in mm: '1.5,0,-2'.")
    ] = None,
    endstops: Annotated[
        str | None,
        option(
            "Where the switches of towers x,y,z trip now, mm: position_endstop (Klipper), "
            "H + M666 (RepRapFirmware), H - M666 (Marlin), Z - M666 (Smoothieware)."
        ),
    ] = None,
    steps: Annotated[
        str | None,
        option(
            "Present value of the firmware for the travel of towers x,y,z: rotation_distance "
            "(Klipper), steps per mm of M92 (others)."
        ),
    ] = None,
    ini: Annotated[
        Path | None, option("LinuxCNC INI file with the present values of the joints.")
    ] = None,
    frame: FrameName = None,
    force: Force = False,
) -> None:
    """What to enter in the controller, as files. For linuxcnc a folder of includes and tables.

    With --table the numbers of a session instead. With -o - one text goes to standard output.
    """
    if (verbs := family_of_files(None, sources).sessions) is not None:
        source = the_session(context, [_only(sources, "postures")], OF_INDICATORS)
        force = may_deliver(output, force=force, folder=format_name == "linuxcnc-kins")
        files, cautions = verbs.exported(source, format_name)
        tell_warnings(cautions)
        deliver(output, files, force=force)
        return
    if table or format_name in ("xlsx", "parquet"):
        joint_options: dict[str, object] = {"--home-offset": home_offset, "--endstops": endstops}
        joint_options |= {"--steps": steps, "--ini": ini}
        _refuse_beside_table(table or "readings", format_name, {**joint_options, "--frame": frame})
        force = may_deliver(output, force=force)
        source = _only(sources, "a table")
        data_table = _table(source, table or "readings", subset, method, model)
        deliver(output, {"": data_table.file_content(format_name)}, force=force)
        return
    from app.exports import FORMATS, IN_FOLDERS
    from app.exports.linuxcnc_ini import read_controller
    from app.report.offsets import offsets_from_files
    from app.report.text.caveats import UNKNOWN_HOME_OFFSET
    from calib.tripod.controller import ControllerJoints
    from protocols.documents import read_bytes

    if format_name not in FORMATS:
        read_bytes(sources[0], "file")  # a file that is not there is no question of its format
        raise UsageError("--format", f"{format_name} of {sources[0]}", ", ".join(FORMATS))
    _check_joints(home_offset, endstops, ini, steps, format_name)
    force = may_deliver(output, force=force, folder=format_name in IN_FOLDERS)
    offsets = offsets_from_files(sources, subset, method, model, frame)
    machine = offsets.machine.holding_steps(_triple("--steps", steps))
    offsets = replace(offsets, machine=machine)
    home = _triple("--home-offset", home_offset)
    if home is None:
        home = machine.tripped_at_mm(_triple("--endstops", endstops))
    if home is not None:
        offsets = replace(offsets, controller=ControllerJoints.homed_at(home, machine.joints))
    if ini:
        offsets = replace(offsets, controller=read_controller(ini))
    exported = FORMATS[format_name](offsets)
    tell_warnings(exported.cautions)
    if format_name.startswith("linuxcnc") and offsets.controller is None:
        say(f"glidecal: WARNING: {UNKNOWN_HOME_OFFSET}")
    deliver(output, exported.files, force=force)


OF_FIRMWARE = ("klipper", "reprapfirmware", "marlin", "smoothieware")
"""Formats whose files state the travel of towers."""


def _check_joints(
    home_offset: str | None,
    endstops: str | None,
    ini: Path | None,
    steps: str | None,
    format_name: str,
) -> None:
    """Raises UsageError for what the joints hold, where it is said twice or for no format."""
    present = {"--home-offset": home_offset, "--endstops": endstops, "--ini": ini}
    entries = [option for option, value in present.items() if value is not None]
    if len(entries) > 1:
        raise UsageError("--home-offset, --endstops and --ini", "more than one", "one of them")
    if entries and format_name in ("json", "csv", "model"):
        raise UsageError(entries[0], f"--format {format_name}", "a format of a controller")
    if ini and format_name in (*OF_FIRMWARE, "p-3z"):
        raise UsageError("--ini", f"--format {format_name}", "a LinuxCNC format, or --endstops")
    if steps is not None and format_name not in OF_FIRMWARE:
        raise UsageError("--steps", f"--format {format_name}", ", ".join(OF_FIRMWARE))


def _only(sources: Sequence[Path], subject: str) -> Path:
    if len(sources) > 1:
        raise UsageError("glidecal export", f"{len(sources)} files", f"one session, for {subject}")
    return sources[0]


def history(
    folder: Annotated[Path, argument("Folder with sessions, and those below it.")] = Path(),
    machine: Annotated[
        str | None, option("Only this machine, by its name or serial number.")
    ] = None,
    effects: Annotated[
        bool, option("Also diagnose each session; slow the first time.", "--effects")
    ] = False,
    within_s: Annotated[
        float | None,
        option(
            "Seconds; sessions that are not worked out by then are left for the next time.",
            "--within",
            min=0.0,
        ),
    ] = None,
    screen: Annotated[bool, option("Show it on a screen.", "--screen")] = False,
    output: Annotated[
        Path | None,
        file("Page with figures to write, as HTML; - is standard output.", "--output", "-o"),
    ] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """All sessions of a folder over time. Changes, drift, and when the next one is due."""
    import os
    from datetime import UTC, datetime

    from app.evaluating.history import read_history

    forms = {"--screen": screen, "--output": output is not None, "--json": as_json}
    if len(options := [name for name, is_present in forms.items() if is_present]) > 1:
        raise UsageError(" and ".join(options), "more than one", "one of them")
    if output is not None:
        force = may_deliver(output, force=force, suffix=".html")
    # a server ends this process by force, and no other one that it began
    processors = (os.cpu_count() or 1) if within_s is None else 1
    with working("Working out sessions", "sessions"):
        past = read_history(
            folder, effects=effects, of_postures=LOOKS, within_s=within_s, processors=processors
        )
    if machine is not None:
        past = past.only(machine)
    if screen:
        from app.report.streams import need_terminal
        from app.screens.history import HistoryScreen
        from app.screens.interface import open_screen

        need_terminal("history", "history without --screen")
        raise typer.Exit(open_screen(HistoryScreen(past), LOOKS))
    from app.report.schema.history import HistoryReport
    from app.report.text.history import history_text

    now = datetime.now(UTC)
    if output is not None:
        with extra("glidecal history -o", "report"):
            from app.report.pages.history import history_page
            from app.report.pages.report import html_of
        deliver(output, {"": html_of(history_page(past, now))}, force=force)
        return
    Answer(past, lambda past: history_text(past, now), HistoryReport.of).show(as_json=as_json)


def _refuse_beside_table(name: str, format_name: str, options: dict[str, object]) -> None:
    """Raises UsageError for what a table cannot be written as, or has no use for."""
    from protocols.data_table import FORMATS

    if format_name not in FORMATS:
        raise UsageError("--table", f"--format {format_name}", "csv, xlsx or parquet")
    for option_name, value in options.items():
        if value:
            raise UsageError(option_name, f"a table of {name}", "with offsets alone")


def _table(
    source: Path,
    name: TableName | Literal["readings"],
    subset: SubsetName | None,
    method: Literal["linear", "exact"],
    model: Path | None,
) -> DataTable:
    from app.evaluating.loading import load_sessions
    from app.evaluating.solution import solve_files

    if name == "readings":
        (session,), warnings = load_sessions([source])
        data = session.table()
    else:
        result = solve_files([source], subset=subset, method=method, model=model)
        data, warnings = result.table(name), [*result.warnings]
    tell_warnings(warnings)
    return data


def report(
    context: typer.Context,
    sessions: Sessions,
    output: Output,
    model: Annotated[
        Path | None, file("Model with effects; their sizes are fitted, too.", to_read=True)
    ] = None,
    after: Annotated[Path | None, file("Session with the offsets entered.", to_read=True)] = None,
    tolerance: Tolerance = None,
    certificate: Annotated[
        Path | None, file("Number, customer and place (TOML): a certificate.", to_read=True)
    ] = None,
    sign: Annotated[
        Path | None, file("Of a certificate as .xml: key and certificate, PEM or PKCS#12.")
    ] = None,
    force: Force = False,
) -> None:
    """The report to sign, as .html, .pdf or .xml. With -o - as HTML on standard output.

    With --certificate it has a number and the head of the laboratory in the settings file; as .xml
    it is a digital calibration certificate (DCC 3.2.1).
    """
    from protocols.files import STANDARD_OUTPUT

    if sign and (certificate is None or output.suffix != ".xml"):
        raise UsageError("--sign", f"--output {output}", "--certificate and an output as .xml")
    verbs = family_of_files(None, sessions).sessions
    if verbs is not None:
        the_session(context, sessions, ("model",))
    streamed = output == STANDARD_OUTPUT
    may = force if streamed else may_replace(force, output)
    with extra("glidecal report", "report"):
        from app.report.certificate import read_head
        from app.report.pages.report import html_of, source_of_legs, write_report

        head = read_head(certificate) if certificate else None
    key = None
    if sign:
        with extra("glidecal report --sign", "sign"):
            from app.report.dcc.signature import read_key

        key = read_key(sign, _key_password)
    source: Callable[[], ReportSource] = partial(
        source_of_legs, sessions, model=model, later_path=after, tolerance_mm=tolerance, head=head
    )
    if verbs is not None:
        source = partial(verbs.reported, sessions[0], after, tolerance, head)
    if streamed:
        typer.echo(html_of(source().page()), nl=False)
        return
    with working("Writing the report"):
        path = write_report(source, output, head, key, replace=may)
    say(f"written: {path}")


def _key_password() -> str:
    """The password of the key, from the environment or typed at the terminal. Raises UsageError."""
    if (password := os.environ.get(PASSWORD_VARIABLE)) is not None:
        return password
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise UsageError("--sign", "a key with a password", f"it in {PASSWORD_VARIABLE}")
    typed: str = typer.prompt("Password of the key", hide_input=True, err=True)
    return typed


def _triple(option: str, text: str | None) -> tuple[float, float, float] | None:
    from protocols.data_table import NUMBER
    from protocols.documents import LARGEST_MM

    if text is None:
        return None
    parts = text.split(",")
    if len(parts) == 3 and all(NUMBER.fullmatch(part.strip()) for part in parts):
        x, y, z = (float(part) for part in parts)
        if max(abs(x), abs(y), abs(z)) <= LARGEST_MM:
            return x + 0.0, y + 0.0, z + 0.0  # -0 is 0
    allowed = f"three numbers in mm, such as '1.5,0,-2', up to {LARGEST_MM:,.0f}"
    raise UsageError(option, repr(text), allowed)
