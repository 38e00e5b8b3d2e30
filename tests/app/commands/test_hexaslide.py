"""The Hexa Slide on the command line."""

from __future__ import annotations

import itertools
import json
import re
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from app.exit_codes import Exit, exit_code
from app.planning.hexaslide import Request, hexaslide_planning
from app.report.schema.hexaslide import (
    HexaSlideIdentifiabilityReport,
    rules_of,
)
from app.report.text.hexaslide import seen_text
from calib.errors import RecordError
from calib.hexaslide.derivatives import jacobian
from calib.hexaslide.planning import HexaSlideSeen, look_at
from calib.hexaslide.procedures import Procedure, held_postures
from protocols.hexaslide import load_hexaslide, load_postures
from tests.app.cli import glidecal, refused
from tests.conftest import LONG

TEXT = (resources.files("protocols") / "machines" / "hexaslide-h60.toml").read_text("utf-8")
VERB = ("identifiability", "hexaslide", "--procedure")


@pytest.mark.parametrize(
    ("procedure", "rank", "count", "published", "fewest"),
    [
        ("pose-inverse", 49, 49, 49, 9),
        ("position", 46, 49, 48, 16),
        ("constraint-link", 48, 55, 46, 48),
    ],
)
def test_ranks_beside_those_of_the_paper(
    procedure: str, rank: int, count: int, published: int, fewest: int
) -> None:
    run = glidecal(*VERB, procedure, "--json")
    assert run.status == 0, run.err
    report = json.loads(run.out)
    assert (report["rank"], report["parameter_count"]) == (rank, count)
    assert (report["published_rank"], report["fewest_postures"]) == (published, fewest)
    assert report["limited_by"] == "nothing"
    assert len(report["lost_directions"]) == count - rank
    assert bool(report["remark"]) == (rank != published)


def seen_of(request: Request) -> HexaSlideSeen:
    return look_at(hexaslide_planning(request))


def told(request: Request) -> str:
    """What the verb says, as one line."""
    return " ".join(seen_text(seen_of(request)).split())


def test_too_few_postures_say_the_minimum_and_what_is_lost_in_whole() -> None:
    report = json.loads(glidecal(*VERB, "position", "--postures", "15", "--json").out)
    assert (report["limited_by"], report["rank"], report["reachable_rank"]) == (
        "too-few-postures",
        45,
        46,
    )
    directions = report["lost_directions"]
    assert [direction["at_every_posture"] for direction in directions] == [True, True, True, False]
    machine = load_hexaslide().whole()
    rows = jacobian(Procedure.of("position"), machine.geometry, held_postures(machine, 15, 0))
    names = report["parameters"]
    for loss in directions:
        vector = np.array([loss["combination"].get(name, 0.0) for name in names])
        assert np.linalg.norm(rows.reshape(-1, 49) @ vector) < 1e-8 * np.linalg.norm(vector)
    text = told(Request("position", postures=15))
    assert "Too few postures: 16 or more are needed to see the 46" in text
    assert "and smaller shares of" in text
    assert "Other postures show this." in text


def test_what_is_lost_is_told_by_its_motions_and_their_number() -> None:
    text = told(Request("constraint-link"))
    for motion in (
        "NOT IDENTIFIABLE (3): platform frame turned about its X, Y and Z.",
        "NOT IDENTIFIABLE (3): platform frame shifted along its X, Y and Z.",
        "NOT IDENTIFIABLE (1): base turned about X. No posture shows this",
    ):
        assert motion in text
    assert "48 of 55 combinations of the parameters are identifiable, 7 not." in text
    assert "Fewest postures that show so many: 48." in text
    assert "papers/001 counts 46; with exact derivatives it is 48" in text


def test_the_rule_of_the_paper_is_told_beside_with_what_decides_it() -> None:
    text = told(Request("position"))
    assert "rank 46 with exact derivatives, flags Bz5, By6, Bz6." in text
    assert "at 16 postures its rank is 48. WARNING: that is the number of rows" in text
    assert "at 100 postures its rank is 49. WARNING: that is the number of parameters" in text
    assert "orders of magnitude too tight" in text
    rules = rules_of(seen_of(Request("constraint-link")))
    many, few = rules.forward_differences
    assert rules.rank == 48
    assert (many.rank, many.true_rank, many.decided_by) == (55, 48, "parameters")
    assert (few.postures, few.rank, few.decided_by) == (46, 46, "rows")
    least, largest = many.errors_in_tolerances or (0.0, 0.0)
    assert 1e4 < least < largest < 1e9
    text = told(Request("pose-inverse"))
    assert "WARNING" not in text
    assert "at 9 postures its rank is 49." in text
    assert "WARNING: 45 is wrong: without exchange of columns" in told(
        Request("position", postures=16)
    )


def test_condition_numbers_have_their_units() -> None:
    analysis = seen_of(Request("pose-forward"))
    report = HexaSlideIdentifiabilityReport.of(analysis.seen, analysis)
    figures = report.condition_numbers
    assert set(figures) == {"m, rad", "mm, rad", "m, °", "scaled"}
    assert figures["m, rad"] == pytest.approx(report.condition_number)
    assert figures["mm, rad"] > 10.0 * figures["m, rad"]
    text = told(Request("pose-forward"))
    assert all(f"in {units}" in text for units in figures if units != "scaled")
    assert f"no unit matters: {figures['scaled']:.4g}." in text
    assert "It depends on the units" in text


def test_a_measured_tilt_is_seen() -> None:
    run = glidecal("identifiability", "hexaslide", "--measured", "x,y,z,theta")
    assert "48 of 49 combinations" in run.out
    assert "NOT IDENTIFIABLE (1): platform frame turned about its Z." in run.out


def test_what_is_known_of_the_link() -> None:
    report = json.loads(glidecal(*VERB, "constraint-link", "--known", "c,d,length", "--json").out)
    assert (report["rank"], report["parameter_count"], report["published_rank"]) == (46, 49, None)
    text = told(Request("constraint-link", known=()))
    assert "49 of 56 combinations" in text
    assert "turned about the link's end, X and Y" in told(
        Request("constraint-link", known=("c", "length"))
    )


def test_postures_of_a_file(tmp_path: Path) -> None:
    machine, columns = load_hexaslide(), "x_m,y_m,z_m,theta_deg,psi_deg,phi_deg"
    postures = machine.whole().box.random(40, np.random.default_rng(3))
    postures[:, 3:] = 0.0
    table = tmp_path / "own.csv"
    lines = [columns, *(",".join(map(str, row)) for row in postures)]
    table.write_text("\n".join(lines), encoding="utf-8")
    report = json.loads(glidecal(*VERB, "position", "--posture-file", table, "--json").out)
    assert (report["rank"], report["reachable_rank"]) == (32, 46)
    assert (report["postures"]["count"], report["limited_by"]) == (40, "too-few-postures")
    text = told(Request("position", posture_file=table))
    assert "too much alike: others show 46. Vary all six coordinates." in text
    assert "more such sums; --json lists them" in text
    path = tmp_path / "own.json"
    rows_by_name = [dict(zip(columns.split(","), row, strict=True)) for row in postures.tolist()]
    path.write_text(json.dumps({"schema": "x", "postures": rows_by_name}), encoding="utf-8")
    assert seen_of(Request("position", posture_file=path)).seen.identifiability.rank == 32


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x_m,y_m\n", "line 1: columns x_m, y_m"),
        ("", "line 1: columns none"),
        ("{columns}\n", "0 postures"),
        ("{columns}\n0,-0.8,-1.15,0,0,0\n0,-0.8,high,0,0,0\n", "line 3: no six numbers"),
        ("{columns}\n0,-0.8,-1.15,0,0\n", "line 2: no six numbers"),
        ("{columns}\n0,-0.8,nan,0,0,0\n", "line 2: "),
        ("{columns}\n0,-0.8,-1.15,0,0,400\n", "must be at most 360"),
    ],
)
def test_a_wrong_posture_file_is_told(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "own.csv"
    columns = "x_m,y_m,z_m,theta_deg,psi_deg,phi_deg"
    path.write_text(text.replace("{columns}", columns), encoding="utf-8")
    with pytest.raises(RecordError, match=re.escape(words)) as told_so:
        load_postures(path)
    assert exit_code(told_so.value) == Exit.RECORD


def test_postures_that_cannot_be_are_told(tmp_path: Path) -> None:
    path = tmp_path / "own.csv"
    header = "x_m,y_m,z_m,theta_deg,psi_deg,phi_deg\n"
    path.write_text(f"{header}5,-0.8,-1.15,0,0,0\n", encoding="utf-8")
    message = refused(5, *VERB, "position", "--posture-file", path)
    assert "posture (5, -0.8, -1.15) m, (0, 0, 0)°: found link 1" in message
    lines = itertools.count()
    on_a_line = re.sub(
        r"joint_mm = \[.*?\]", lambda _: f"joint_mm = [{100.0 * next(lines)}, 0.0, 0.0]", TEXT
    )
    machine = tmp_path / "loose.toml"
    endless = re.sub(r"travel_mm = .*\n", "", on_a_line)
    machine.write_text(endless.replace("link_mm = 880.0", "link_mm = 1500.0"), encoding="utf-8")
    assert "a singular one" in refused(5, *VERB, "position", "--machine-file", machine)


@LONG
def test_postures_before_and_after() -> None:
    verb = ("postures", "hexaslide", "--procedure", "pose-inverse", "--count", "9")
    report = json.loads(glidecal(*verb, "--criterion", "condition", "--starts", "1", "--json").out)
    assert report["condition_number"] < 60.0 < report["start_condition_number"] / 10.0
    assert len(report["postures"]) == 9
    for name, bound in {"x_m": 0.3, "theta_deg": 15.0, "phi_deg": 30.0}.items():
        assert all(abs(posture[name]) <= bound + 1e-9 for posture in report["postures"])


def test_wrong_input_is_told(tmp_path: Path) -> None:
    few = ("postures", "hexaslide", "--procedure", "position", "--count", "15")
    assert "16 or more" in refused(5, *few)
    assert "different ones of x" in refused(2, *VERB, "position", "--measured", "x,roll")
    assert "pose-inverse" in refused(2, *VERB, "sideways")
    assert "of c, d, length" in refused(2, *VERB, "constraint-link", "--known", "e")
    assert "--measured also does" in refused(2, "identifiability", "hexaslide")
    options = ("--postures", "20", "--posture-file", tmp_path / "none.csv")
    assert "one of them" in refused(2, *VERB, "position", *options)
    arguments = ("identifiability", "orthoglide", "--procedure", "sweep", "--known", "c")
    assert "the machine hexaslide" in refused(2, *arguments)


def test_legs_without_rails_are_told_of_joints(tmp_path: Path) -> None:
    """Before: of the first rail."""
    path = tmp_path / "legs.toml"
    assert glidecal("machine", "gough-stewart", "-o", path).status == 0
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("start_mm = [0.0,", "start_mm = [0.5,", 1), encoding="utf-8")
    with pytest.raises(RecordError) as refusal:
        load_hexaslide(path)
    assert "the first leg at [0, 0, 0], the second at [x, 0, 0]" in str(refusal.value)
    assert "first rail" not in str(refusal.value)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("rail = [0.0, -0.5", "rail = [0.0, -0.6", "line 9, chain.0.rail: a unit"),
        ("rail = [0.0, -0.5, -0.866025403784439]", "rail = [0.0, -1.0, 0.0]", "not level"),
        ("link_mm = 880.0", "link = 880.0", "line 11, chain.0.link: no such key"),
        ("x_mm = [-300.0, 300.0]", "x_m = [-0.3, 0.3]", "line 51, box.x_m: no such key"),
        ("travel_mm = [0.0", "travel_mm = [2000.0", "chain.0.travel_mm: the lower bound"),
        ("x_mm = [-300.0, 300.0]", "x_mm = [300.0, -300.0]", "line 51, box.x_mm: the lower"),
        ("x_mm = [-300.0, 300.0]", "x_mm = [-2000.0, 300.0]", "line 50, box: posture (-2, "),
        ("start_mm = [0.0, 0.0, 0.0]", "start_mm = [0.1, 0.0, 0.0]", "the first rail at [0, 0, 0]"),
        ("[constraint_link]", "[link]", "link: no such key"),
    ],
)
def test_a_wrong_machine_file_is_told(tmp_path: Path, old: str, new: str, words: str) -> None:
    path = tmp_path / "own.toml"
    assert old in TEXT
    path.write_text(TEXT.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(RecordError, match=re.escape(words)) as told_so:
        load_hexaslide(path)
    assert exit_code(told_so.value) == Exit.RECORD
    assert "line " in str(told_so.value)
    assert len(str(told_so.value)) < 400


def test_fewer_than_six_chains_and_no_link_are_told(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    head, *chains = TEXT.split("[[chain]]")
    tail = chains[-1].split("[box]")[1]
    path.write_text("[[chain]]".join([head, *chains[:-1]]) + f"\n[box]{tail}", encoding="utf-8")
    message = refused(3, *VERB, "position", "--machine-file", path)
    assert "six chains, each with its own [[chain]]; here are 5" in message
    path.write_text(TEXT.split("[constraint_link]")[0], encoding="utf-8")
    message = refused(2, *VERB, "constraint-link", "--machine-file", path)
    assert "no [constraint_link]" in message


def test_a_machine_file_in_metres_is_the_same_machine(tmp_path: Path) -> None:
    """Files of schema 1 had metres; a fault in one still names its table's line."""
    lengths = re.compile(r"^(\w+)_mm( = )([^#\n]*)", re.MULTILINE)
    text = TEXT.split("[tolerances]")[0]

    def in_metres(match: re.Match[str]) -> str:
        numbers = re.sub(r"-?\d+\.\d+", lambda number: repr(float(number[0]) / 1000.0), match[3])
        return f"{match[1]}_m{match[2]}{numbers}"

    old = lengths.sub(in_metres, text).replace("hexaslide/2", "hexaslide/1")
    path = tmp_path / "old.toml"
    path.write_text(old, encoding="utf-8")
    machine, now = load_hexaslide(path).whole(), load_hexaslide().whole()
    assert machine.travel_m == pytest.approx(now.travel_m)
    names = Procedure.of("constraint-link", known=()).parameters
    assert machine.parameters(names) == pytest.approx(now.parameters(names), abs=1e-15)
    path.write_text(old.replace("link_m = 0.88", "link_m = -0.88", 1), encoding="utf-8")
    with pytest.raises(RecordError, match=r"line 7, chain\.0\.link_mm: .* \(found -880"):
        load_hexaslide(path)
