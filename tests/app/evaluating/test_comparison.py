"""Two sessions side by side: the published pair, and pairs that do not belong together."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import pytest

from app.evaluating.comparison import compare_files, partner_of
from app.report.schema.solution import ComparisonReport
from calib.errors import CalibrationError, RecordError
from tests.app.cli import glidecal, refused
from tests.app.exports import upright_towers as true
from tests.conftest import LONG
from tests.protocols.printers.answers import CONFIG_G, g32
from tests.protocols.printers.printers import PERFECT

# papers/000, twelve differences of experiments 2 and 3 in mm, in the order of the tables
PUBLISHED = {
    "x_y+": (-0.19, -0.07),
    "y_x+": (0.08, 0.02),
    "x_y-": (0.22, 0.10),
    "y_x-": (-0.34, -0.24),
    "y_z+": (0.02, 0.07),
    "z_y+": (-0.24, -0.21),
    "y_z-": (0.20, 0.17),
    "z_y-": (0.45, 0.27),
    "x_z+": (-0.29, 0.01),
    "z_x+": (-0.52, 0.11),
    "x_z-": (0.08, -0.19),
    "z_x-": (0.62, -0.03),
}


def test_the_published_pair(samples: Path) -> None:
    comparison = compare_files(
        samples / "experiment_2_twelve.jsonl", samples / "experiment_3_twelve.jsonl"
    )
    document = ComparisonReport.of(comparison).model_dump(mode="json")
    assert document["schema"] == "glidecal.comparison/1"
    assert document["before"] == "experiment_2_twelve.jsonl"
    for name, pair in PUBLISHED.items():
        comparison = document["differences"][name]
        assert (comparison["before"], comparison["after"]) == pytest.approx(pair, abs=1e-9)
    for k, key in enumerate(("rms_before_mm", "rms_after_mm")):
        rms = math.sqrt(sum(pair[k] ** 2 for pair in PUBLISHED.values()) / len(PUBLISHED))
        assert document[key] == pytest.approx(rms, abs=1e-9)
    assert 0.0 < document["rms_expected_mm"] < document["rms_after_mm"]
    assert document["remarks"] == []


def test_command_prints_text_and_json(samples: Path) -> None:
    pair = samples / "experiment_2_twelve.jsonl", samples / "experiment_3_twelve.jsonl"
    run = glidecal("compare", *pair)
    assert run.status == 0
    assert "before: experiment_2_twelve.jsonl" in run.out
    assert "from 0.3230 to 0.1508 mm" in run.out
    assert "mm was expected" in run.out
    assert max(map(len, run.out.splitlines())) <= 80
    document = json.loads(glidecal("compare", *pair, "--json").out)
    assert document["differences"]["z_x-"] == {"before": 0.62, "after": -0.03}


def test_nothing_in_common_is_refused(samples: Path) -> None:
    pair = samples / "experiment_2_six.jsonl", samples / "experiment_3_twelve.jsonl"
    assert "no difference that both measured" in refused(5, "compare", *pair)


def test_other_machine_same_session_and_damage_are_refused(samples: Path, tmp_path: Path) -> None:
    twelve = samples / "experiment_2_twelve.jsonl"
    copied = tmp_path / "copy [mm].jsonl"
    shutil.copy(twelve, copied)
    with pytest.raises(RecordError, match="the same session"):
        compare_files(twelve, copied)
    with pytest.raises(RecordError, match="line"):
        compare_files(twelve, samples / "damaged.jsonl")
    table = samples / "tables" / "experiment_3_twelve.csv"
    machine = tmp_path / "longer.toml"
    machine.write_text('name = "longer"\nleg_length_mm = 400.0\n', encoding="utf-8")
    other_session = tmp_path / "other.jsonl"
    assert glidecal("import", table, "-o", other_session, "--machine", machine).status == 0
    with pytest.raises(CalibrationError, match="machines of different geometry"):
        compare_files(twelve, other_session)


def test_remarks_tell_what_does_not_fit(samples: Path, tmp_path: Path) -> None:
    sweep, cycles = samples / "simulated_sweep.jsonl", samples / "simulated_zero-max-min.jsonl"
    cut = tmp_path / "cut.jsonl"
    cut.write_bytes(sweep.read_bytes()[:-200])
    comparison = compare_files(cut, cycles)
    assert any(remark.startswith("cut.jsonl: cut inside line") for remark in comparison.remarks)
    assert not any("differences are in both" in remark for remark in comparison.remarks)
    assert len(comparison.before.solution.differences.published_rows) == 12


def test_differences_of_one_session_alone_are_pointed_at(samples: Path, tmp_path: Path) -> None:
    """Whichever of the two has them: each r.m.s. is over other differences."""
    lines = (samples / "tables" / "experiment_2_twelve.csv").read_text("utf-8").splitlines()
    table, fewer = tmp_path / "fewer.csv", tmp_path / "fewer.jsonl"
    table.write_text("\n".join(line for line in lines if not line.startswith("z,")), "utf-8")
    assert glidecal("import", table, "-o", fewer).status == 0
    twelve = samples / "experiment_3_twelve.jsonl"
    for pair in ((fewer, twelve), (twelve, fewer)):
        (remark,) = compare_files(*pair).remarks
        assert remark.startswith("Only 8 of 12 differences are in both sessions; each r.m.s.")


def test_partner_is_looked_for_beside_the_session(tmp_path: Path) -> None:
    before = tmp_path / "before.jsonl"
    assert partner_of(tmp_path / "after.jsonl", "before.jsonl") is None
    before.touch()
    assert partner_of(tmp_path / "after.jsonl", "before.jsonl") == before
    assert partner_of(tmp_path / "after.jsonl", "elsewhere/before.jsonl") == before
    assert partner_of(tmp_path / "after.jsonl", None) is None


@LONG
def test_files_of_other_names_are_of_the_same_printer(tmp_path: Path) -> None:
    """Before and after its values were entered; another printer is refused."""
    sessions = []
    larger = CONFIG_G.replace(f"R{true.RADIUS}", f"R{true.RADIUS + 40.0}")
    for name, config in (("before", CONFIG_G), ("after", CONFIG_G), ("other", larger)):
        macro, answer = g32(PERFECT if name == "before" else true.OFF_IN_ALL, 3)
        folder = tmp_path / name
        folder.mkdir()
        text = config.replace("Z0 ;", "Z0.1 ;") if name == "after" else config
        for file, content in ((name, text), ("m", macro), ("a", answer)):
            (folder / f"{file}.g").write_text(content, encoding="utf-8")
        files = [folder / f"{file}.g" for file in (name, "m", "a")]
        sessions.append(tmp_path / f"{name}.jsonl")
        run = glidecal("import", *files, "-o", sessions[-1])
        assert run.status == 0, run.err
    before, after, other = sessions
    run = glidecal("compare", before, after)
    assert run.status == 0, run.err
    assert "machines of different geometry" in glidecal("compare", before, other).err
