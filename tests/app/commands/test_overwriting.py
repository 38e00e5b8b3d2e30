"""Every verb that writes a file a person asked for: nothing that is there is lost unasked."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest
import typer
from typer.main import get_command

from app.cli import cli
from calib.errors import RecordError
from protocols import files
from protocols.files import FilesThere, write_files
from tests.app.cli import glidecal, refused
from tests.conftest import LONG, first_quick, needs_links

HEXA = ("--machine", "hexaslide", "--procedure", "pose-inverse", "--postures", "12")
POSTURES = ("--procedure", "zero-max-min", "--count", "9", "--common")
NINE = ("--procedure", "pose-inverse", "--count", "9", "--starts", "1")
SAMPLE = "{samples}/simulated_sweep.jsonl"

WRITING = {
    "export json": (("export", SAMPLE, "--format", "json", "-o", "{}"), ""),
    "export csv": (("export", SAMPLE, "--format", "csv", "-o", "{}"), ""),
    "export model": (("export", SAMPLE, "--format", "model", "-o", "{}"), ""),
    "export linuxcnc": (
        ("export", SAMPLE, "--format", "linuxcnc", "--home-offset", "0,0,0", "-o", "{}"),
        "calib_joint1.inc",
    ),
    "adopt": (("diagnose", SAMPLE, "--candidate", "actuator_scale:all", "--adopt", "{}"), ""),
    "postures": (("postures", "orthoglide", *POSTURES, "-o", "{}.toml"), ""),
    "postures hexaslide": (("postures", "hexaslide", *NINE, "-o", "{}.csv"), ""),
    "simulate hexaslide": (("simulate", *HEXA, "-o", "{}"), ""),
    "its truth": (("simulate", *HEXA, "-o", "{}-other", "--truth", "{}"), ""),
    "macro": (("plan", "--machine", "linear-delta", "--macro", "marlin", "-o", "{}"), ""),
    "machine": (("machine", "-o", "{}.toml"), ""),
    "report": (("report", SAMPLE, "-o", "{}.html"), ""),
    "template": (("import", "{}.csv", "--template"), ""),
    "template xlsx": (("import", "{}.xlsx", "--template"), ""),
}
"""Arguments with the place of the file or folder, and the file that is there in a folder."""

RECORDING = {
    "import": ("import", "{samples}/tables/experiment_2_six.csv", "-o", "{}"),
    "simulate": ("simulate", "-o", "{}"),
    "run": ("run", "--simulated", "--headless", "-o", "{}"),
    "align": ("align", "--simulated", "-o", "{}"),
}

WRITING_OPTIONS = {"output", "adopt", "next_procedure", "template", "folder"}
NO_FORCE = {"run", "align"}
"""They write sessions under new names alone."""


def asked(arguments: tuple[str, ...], samples: Path, at: Path) -> list[str]:
    return [
        argument.replace("{samples}", str(samples)).replace("{}", str(at)) for argument in arguments
    ]


def target_of(name: str, at: Path) -> Path:
    arguments, inside = WRITING[name]
    if inside:
        at.mkdir()
        return at / inside
    suffix = next(
        argument for argument in arguments if argument.startswith("{}") and argument != "{}-other"
    )
    return Path(suffix.replace("{}", str(at)))


@pytest.mark.parametrize("name", first_quick(WRITING))
def test_a_file_that_is_there_is_kept_in_a_pipe_and_replaced_by_force(
    name: str, tmp_path: Path, samples: Path
) -> None:
    at = tmp_path / "out"
    target = target_of(name, at)
    target.write_text("mine", encoding="utf-8")
    arguments = asked(WRITING[name][0], samples, at)
    there = sorted(tmp_path.rglob("*"))
    message = refused(2, *arguments)
    assert f"{target} is there already. Give another name, or --force to replace." in message
    assert target.read_text(encoding="utf-8") == "mine"
    assert sorted(tmp_path.rglob("*")) == there, "nothing is half written beside it"
    assert glidecal(*arguments, "--force").status == 0
    assert target.read_bytes() != b"mine"


@pytest.mark.parametrize("name", RECORDING)
def test_a_session_is_never_replaced(name: str, tmp_path: Path, samples: Path) -> None:
    at = tmp_path / "s.jsonl"
    at.write_text("mine", encoding="utf-8")
    arguments = asked(RECORDING[name], samples, at)
    forced = [*arguments, "--force"] if name not in NO_FORCE else arguments
    assert "a record is never overwritten" in refused(3, *forced)
    assert at.read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize("name", ["export json", "postures", "simulate hexaslide", "template"])
def test_not_even_force_writes_over_a_session(name: str, tmp_path: Path, samples: Path) -> None:
    target = target_of(name, tmp_path / "out")
    session = (samples / "simulated_sweep.jsonl").read_bytes()
    target.write_bytes(session)
    arguments = asked(WRITING[name][0], samples, tmp_path / "out")
    assert "records are kept" in refused(2, *arguments, "--force")
    assert target.read_bytes() == session


@needs_links
@pytest.mark.parametrize("force", first_quick([("--force",), ()]))
@pytest.mark.parametrize("behind", first_quick(["nothing", "a file"]))
@pytest.mark.parametrize("name", WRITING)
def test_no_verb_writes_through_a_link(
    name: str, behind: str, force: tuple[str, ...], tmp_path: Path, samples: Path
) -> None:
    at, victim = tmp_path / "out", tmp_path / "victim"
    target = target_of(name, at)
    if behind == "a file":
        victim.write_text("untouched", encoding="utf-8")
    target.symlink_to(victim)
    there = sorted(tmp_path.rglob("*"))
    message = refused(2, *asked(WRITING[name][0], samples, at), *force)
    assert f"{target}, a link to {victim}" in message
    assert target.is_symlink()
    assert victim.exists() == (behind == "a file")
    assert not victim.exists() or victim.read_text(encoding="utf-8") == "untouched"
    assert sorted(tmp_path.rglob("*")) == there, "nothing is half written beside it"


@needs_links
def test_a_folder_may_be_a_link(tmp_path: Path, samples: Path) -> None:
    real, linked = tmp_path / "real", tmp_path / "linked"
    real.mkdir()
    linked.symlink_to(real)
    sample = samples / "simulated_sweep.jsonl"
    assert glidecal("export", sample, "--format", "csv", "-o", linked / "o.csv").status == 0
    homing = ("--home-offset", "0,0,0")
    assert glidecal("export", sample, "--format", "linuxcnc", *homing, "-o", linked).status == 0
    assert {path.name for path in real.iterdir()} == {
        "o.csv",
        *(f"calib_joint{n}.inc" for n in range(3)),
    }


@needs_links
@pytest.mark.parametrize("names", [("",), ("a", "b")])
@pytest.mark.parametrize("replace", [False, True])
def test_a_link_that_comes_while_a_file_is_written_leads_nowhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, names: tuple[str, ...], *, replace: bool
) -> None:
    """Between the look at a target and its new name somebody puts a link there."""
    victim = tmp_path / "victim"
    victim.write_text("untouched", encoding="utf-8")
    out = tmp_path / "out"
    last = out / names[-1] if names[-1] else out
    stage = files.stage

    def staged_slowly(target: Path, content: str | bytes) -> Path:
        if target == last:
            target.symlink_to(victim)
        return stage(target, content)

    monkeypatch.setattr(files, "stage", staged_slowly)
    with pytest.raises(RecordError, match="a link"):
        write_files(out, dict.fromkeys(names, "new"), replace=replace)
    assert victim.read_text(encoding="utf-8") == "untouched"
    assert sorted(tmp_path.rglob("*.part")) == []


NO_TEXT = {
    "linuxcnc": ("export", SAMPLE, "--format", "linuxcnc", "--home-offset", "0,0,0", "-o", "-"),
    "xlsx": ("export", SAMPLE, "--format", "xlsx", "-o", "-"),
    "parquet": ("export", SAMPLE, "--format", "parquet", "-o", "-"),
    "adopt": ("diagnose", SAMPLE, "--candidate", "actuator_scale:all", "--adopt", "-"),
    "next": ("diagnose", SAMPLE, "--next", "-"),
    "template": ("import", "-", "--template"),
    "its truth": ("simulate", *HEXA, "-o", "{}", "--truth", "-"),
    "postures": ("postures", "orthoglide", *POSTURES, "-o", "-"),
    "postures hexaslide": ("postures", "hexaslide", *NINE, "-o", "-"),
}
"""They write several files, bytes, or a file beside their result."""


@pytest.mark.parametrize("name", NO_TEXT)
def test_standard_output_takes_one_text_alone(name: str, tmp_path: Path, samples: Path) -> None:
    arguments = asked(NO_TEXT[name], samples, tmp_path / "out")
    assert "standard output" in refused(2, *arguments, cwd=tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("format_name", "output", "words"),
    [("json", "there", "is there already"), ("linuxcnc", "-", "standard output")],
)
def test_an_export_is_refused_before_anything_is_worked_out(
    format_name: str, output: str, words: str, tmp_path: Path, samples: Path
) -> None:
    (tmp_path / "there").touch()
    sample = samples / "simulated_sweep.jsonl"
    run = glidecal("export", sample, "--format", format_name, "-o", output, cwd=tmp_path)
    (only_line,) = run.err.splitlines()
    assert (run.status, words in only_line) == (2, True)


@pytest.mark.parametrize("name", RECORDING)
def test_a_record_is_a_file(name: str, tmp_path: Path, samples: Path) -> None:
    arguments = [
        "-" if argument == "{}" else argument.replace("{samples}", str(samples))
        for argument in RECORDING[name]
    ]
    assert "standard output" in refused(3, *arguments, cwd=tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "arguments",
    first_quick(
        [
            ("export", SAMPLE, "--format", "json"),
            ("export", SAMPLE, "--format", "csv"),
            ("export", SAMPLE, "--format", "model"),
            ("export", SAMPLE, "--format", "csv", "--table", "residuals"),
            ("export", "{delta}", "--format", "klipper", "--endstops", "300,300,300"),
            ("export", "{delta}", "--format", "reprapfirmware", "--endstops", "300,300,300"),
            ("simulate", *HEXA),
            ("report", SAMPLE),
        ]
    ),
)
def test_one_text_goes_to_standard_output(
    arguments: tuple[str, ...], tmp_path: Path, samples: Path
) -> None:
    """The same text as in a file, and no file."""
    delta, html = tmp_path / "delta.jsonl", ".html" if arguments[0] == "report" else ""
    if "{delta}" in arguments:
        run = glidecal("simulate", "--machine", "linear-delta", "-o", delta)
        assert run.status == 0, run.err
    filled = [
        argument.replace("{delta}", str(delta)) for argument in asked(arguments, samples, tmp_path)
    ]
    out, empty = tmp_path / f"out{html}", tmp_path / "empty"
    empty.mkdir()
    assert glidecal(*filled, "-o", out).status == 0
    run = glidecal(*filled, "-o", "-", cwd=empty)
    assert run.status == 0, run.err
    assert run.out == out.read_text(encoding="utf-8")
    assert "written" not in run.err
    assert list(empty.iterdir()) == []


def test_every_verb_with_a_file_to_write_stands_above() -> None:
    command = get_command(cli)
    assert isinstance(command, typer.core.TyperGroup)
    writing = {
        name
        for name, verb in command.commands.items()
        if WRITING_OPTIONS & {parameter.name for parameter in verb.params}
    }
    verbs = {arguments[0] for arguments, _ in WRITING.values()} | {a[0] for a in RECORDING.values()}
    assert writing - {"demo", "history"} == verbs, "their folder is where sessions lie"
    for name in verbs - NO_FORCE:
        assert "force" in {parameter.name for parameter in command.commands[name].params}, name


@LONG
def test_the_known_model_goes_on_without_a_question(tmp_path: Path, samples: Path) -> None:
    model = tmp_path / "m.json"
    session = samples / "simulated_sweep.jsonl"
    first = ("diagnose", session, "--adopt", model, "--candidate", "actuator_scale:all")
    assert glidecal(*first).status == 0
    again = (
        "diagnose",
        session,
        "--model",
        model,
        "--adopt",
        model,
        "--candidate",
        "gravity_sag:y",
    )
    assert glidecal(*again).status == 0
    text = glidecal("model", model).out
    assert "actuator_scale (all)" in text
    assert "gravity_sag (y)" in text


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("json", "not an ordinary file. Allowed: a file"),
        ("linuxcnc", "not a folder. Allowed: a folder"),
    ],
)
def test_a_folder_for_a_file_and_the_reverse_are_refused_before_the_work(
    name: str, words: str, tmp_path: Path, samples: Path
) -> None:
    """Before: after all results were told; with --force beside a file as "File exists"."""
    target = tmp_path / "target"
    target.mkdir() if name == "json" else target.write_text("mine", encoding="utf-8")
    session = samples / "experiment_1_six.jsonl"
    message = refused(2, "export", session, "--format", name, "-o", target, "--force")
    assert words in message
    assert "Tool over the workspace" not in message


def test_a_disk_that_is_full_leaves_no_folder_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(target: Path, content: str | bytes) -> Path:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(files, "stage", full)
    with pytest.raises(RecordError, match="No space left"):
        write_files(tmp_path / "new" / "deeper", {"a": "new", "b": "new"})
    assert list(tmp_path.iterdir()) == []


def test_a_folder_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    (tmp_path / "b").write_text("mine", encoding="utf-8")
    with pytest.raises(FilesThere, match=r"b is there already\."):
        write_files(tmp_path, {"a": "new", "b": "new"})
    assert not (tmp_path / "a").exists()
    write_files(tmp_path, {"a": "new", "b": b"new"}, replace=True)
    assert (tmp_path / "b").read_bytes() == b"new"
    with pytest.raises(FilesThere, match=r"/a, b are there already\. Give"):
        write_files(tmp_path, {"a": "newer", "b": "newer"})
