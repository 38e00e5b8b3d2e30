"""A hidden effect: in the machine, not in the record, of a size that shows."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.evaluating.solution import solve_files
from app.measuring.demo import demo_plan
from app.measuring.opening import start_session
from app.measuring.plan import Plan, verification_plan
from app.measuring.simulated import hidden_effect, planned_readings
from app.measuring.unattended import measure_all
from calib.arrays import Observations
from calib.errors import UsageError
from calib.tripod.effects import CATALOGUE
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.pipeline import derivatives
from calib.tripod.simulation import hidden_machine
from protocols.machine import load_machine
from protocols.observations import to_observations
from protocols.procedure import load_procedure
from protocols.record import read_record
from protocols.session import fold
from tests.app.cli import glidecal, refused
from tests.conftest import LONG, first_quick

IDS = tuple(dict.fromkeys(effect.id for effect in CATALOGUE))
LENGTH = "leg_length"  # lengths are always fitted: it takes a size to show beyond its tolerance
PLATE = "plate_tilt"  # only the tool over a plate shows it: tests/app/evaluating/test_contacts.py
MACHINE = load_machine(None)
NOISE_MM = 0.002


def plan_with(folder: Path, effect: str, protocol: str = "zero-max-min") -> Plan:
    """A demonstration with a hidden effect and without scatter."""
    plan = demo_plan(folder, protocol, 4, effect=effect)
    return replace(plan, bench=replace(plan.bench, scatter_mm=0.0))


def measured(plan: Plan) -> Observations:
    with start_session(plan) as guided:
        measure_all(guided)
    return to_observations([fold(read_record(plan.path).events)])


@pytest.mark.parametrize("effect_id", [effect for effect in IDS if effect not in (LENGTH, PLATE)])
@pytest.mark.parametrize("protocol", first_quick(["zero-max-min", "two-station"]))
def test_every_effect_shows_and_nothing_else_imitates_it(effect_id: str, protocol: str) -> None:
    """What offsets, lengths and zeros leave of it stands far above the noise; no monster."""
    tolerance = {effect.parameters: effect.parameters[0].tolerance for effect in CATALOGUE}
    conditions = planned_readings(load_procedure(protocol, MACHINE.geometry()), MACHINE)
    for seed in (1, 2, 3):
        truth = hidden_machine(MACHINE.geometry(), seed)
        effects = hidden_effect(effect_id, truth, conditions, seed=seed, noise_mm=NOISE_MM)
        assert {effect.id for effect in effects} == {effect_id}
        shift = replace(truth, effects=effects).readings(conditions) - truth.readings(conditions)
        zeros = np.eye(conditions.mount_count)[conditions.mount]
        base = np.hstack([zeros, derivatives(truth.geometry, truth.parameters_mm, conditions)])
        residual = shift - base @ np.linalg.lstsq(base, shift, rcond=None)[0]
        assert 0.9 * NOISE_MM < np.sqrt((residual**2).mean()) < 6 * NOISE_MM
        assert (residual**2).sum() > 50 * NOISE_MM**2
        for instance in effects:
            limit = 60.01 * tolerance[instance.effect.parameters]
            assert all(0.0 < abs(value) <= limit for value in instance.values)


def test_a_length_is_hidden_by_its_size_alone(tmp_path: Path) -> None:
    arguments = ("simulate", "--effect", f"{LENGTH}:x", "-o", tmp_path / "s.jsonl")
    assert "state its size with --size" in refused(2, *arguments)
    assert glidecal(*arguments, "--protocol", "two-station", "--size", "2").status == 0
    text = glidecal("diagnose", tmp_path / "s.jsonl").out
    assert LENGTH in text


def test_the_same_seed_hides_the_same_effect(tmp_path: Path) -> None:
    first, again = (plan_with(tmp_path, "gauge_tilt").bench.effects for _ in range(2))
    assert first == again


@LONG
@pytest.mark.parametrize("effect", ["backlash", "leg_taper"])
def test_the_bench_measures_the_machine_with_its_effect(tmp_path: Path, effect: str) -> None:
    """Readings equal the simulation over the conditions of the record, to the display's step."""
    plan = plan_with(tmp_path, effect, "sweep")
    observations = measured(plan)
    truth = hidden_machine(plan.machine.geometry(), plan.seed)
    exact = replace(truth, effects=plan.bench.effects).readings(observations)
    residual = observations.value_mm - exact
    for mount in range(observations.mount_count):
        assert np.ptp(residual[observations.mount == mount]) <= 0.0011
    without = observations.value_mm - truth.readings(observations)
    assert max(np.ptp(without[observations.mount == k]) for k in range(6)) > 0.01


def test_drift_of_the_bench_follows_the_recorded_times(tmp_path: Path) -> None:
    plan = plan_with(tmp_path, "thermal_drift")
    observations = measured(plan)
    truth = hidden_machine(plan.machine.geometry(), plan.seed)
    rates = {
        effect.place: effect.values[0]
        for effect in plan.bench.effects
        if isinstance(effect, EffectInstance)
    }
    residual = observations.value_mm - truth.readings(observations)
    for mount in range(observations.mount_count):
        rows = observations.mount == mount
        slope = np.polyfit(observations.time_s[rows], residual[rows], 1)[0]
        rate = float(np.real(rates.get("xyz"[observations.axis[rows][0]], 0.0)))
        expected = rate * 1e-3 / 3600.0 * plan.bench.clock_rate
        # the display's step alone makes a slope of about step / duration
        step = 0.001 / float(np.ptp(observations.time_s[rows]))
        assert slope == pytest.approx(expected, abs=0.35 * abs(expected) + step)


def test_the_record_tells_nothing_and_verification_keeps_it(tmp_path: Path) -> None:
    plan = plan_with(tmp_path, "axis_squareness")
    measured(plan)
    text = plan.path.read_text(encoding="utf-8")
    assert "square" not in text
    assert "effect" not in text
    after = verification_plan(plan, solve_files([plan.path]))
    assert after.bench.effects == plan.bench.effects


@LONG
def test_demo_says_where_to_look(tmp_path: Path) -> None:
    run = glidecal("demo", "--headless", "--effect", "straightness", "--seed", "2", cwd=tmp_path)
    assert run.status == 0, run.err
    last = run.out.strip().splitlines()[-1]
    assert "glidecal diagnose demo-sessions" in last
    # only the bound names an effect: what the readings leave open, as solve says of any session
    (session,) = (tmp_path / "demo-sessions").glob("*_demo.jsonl")
    result = glidecal("solve", session, "--subset", "joint-offsets").out
    left_open = re.compile(r"up to \S+ mm if (?:(?!up to).)*, which these readings do not rule out")
    words, alone = (" ".join(text.split()) for text in (run.out, result))
    assert left_open.findall(words) == left_open.findall(alone)
    assert "straightness" not in left_open.sub("", words)
    plain = glidecal("demo", "--headless", "--seed", "2", cwd=tmp_path)
    assert "glidecal diagnose demo-sessions" not in plain.out  # chance may warn of a drift


@LONG
def test_the_whole_loop_names_what_is_hidden(tmp_path: Path) -> None:
    (tmp_path / "both.toml").write_text(
        'schema = "glidecal.procedure/1"\nname = "both"\ntitle = "From both sides"\n'
        'cycles = 1\nlevels = ["zero", "max", "zero", "min", "zero"]\n'
    )
    words = ("--protocol", "both.toml", "--effect", "backlash:x", "--seed", "2")
    run = glidecal("demo", "--headless", "--controller", "twin", *words, cwd=tmp_path)
    assert run.status == 0, run.err
    (session,) = (tmp_path / "demo-sessions").glob("*_demo.jsonl")
    verdict, _, _ = glidecal("diagnose", session).out.partition("\n\n")
    assert run.out.rstrip().endswith(verdict)
    assert "EXPLAINED" in verdict
    assert "has play" in verdict
    assert "(x)" in verdict


@pytest.mark.parametrize("verb", ["demo", "simulate"])
def test_unknown_effect_is_status_2_with_the_list(tmp_path: Path, verb: str) -> None:
    output = ["-o", "s.jsonl"] if verb == "simulate" else ["--headless"]
    message = refused(2, verb, "--effect", "back_lash", *output, cwd=tmp_path)
    assert "'back_lash'" in message
    assert all(effect in message for effect in IDS)
    assert not list(tmp_path.iterdir())


def test_simulate_with_an_effect_of_a_stated_size(tmp_path: Path) -> None:
    quiet = ["--scatter", "0", "--resolution", "0", "--seed", "3"]
    values = []
    for name, options in (("a", []), ("b", ["--effect", "gauge_gain:xy", "--size", "10"])):
        path = tmp_path / f"{name}.jsonl"
        model = tmp_path / "model.json"
        model.write_text('{"parameters_mm": {"d_rho_x": 1.0}}')
        run = glidecal("simulate", "--model", model, *quiet, *options, "-o", path)
        assert run.status == 0, run.err
        readings = json.loads(glidecal("replay", path, "--json").out)["readings"]
        values.append([r["value_mm"] for r in readings if (r["leg"], r["axis"]) == ("x", "y")])
    plain, gained = (np.array(column) - column[0] for column in values)
    assert np.abs(plain).max() > 0.1
    factor = (plain @ gained) / (plain @ plain)
    assert abs(factor - 1.0) == pytest.approx(0.1, abs=1e-9)
    assert gained == pytest.approx(factor * plain, abs=1e-9)


def test_places_and_options_that_do_not_fit(tmp_path: Path) -> None:
    out = tmp_path / "s.jsonl"
    assert "xy, " in refused(2, "simulate", "--effect", "leg_taper:w", "-o", out)
    assert "--effect" in refused(2, "simulate", "--size", "1", "-o", out)
    silent = planned_readings(load_procedure("zero-max-min", MACHINE.geometry()), MACHINE)
    untimed = replace(silent, time_s=np.full(len(silent), np.nan))
    with pytest.raises(UsageError, match="nothing to see"):
        hidden_effect(
            "thermal_drift",
            hidden_machine(MACHINE.geometry(), 1),
            untimed,
            seed=1,
            noise_mm=NOISE_MM,
        )


def test_a_size_is_not_advised_where_none_would_show(tmp_path: Path) -> None:
    """On a machine without errors readings hardly change, and their gain does nothing.

    Before: --size was advised, also to who had stated it, and --protocol two-station in vain.
    """
    out, model = tmp_path / "s.jsonl", tmp_path / "model.json"
    effect = ("--effect", "gauge_gain", "--size", "5")
    message = refused(2, "simulate", *effect, "-o", out)
    assert "effect gauge_gain: found nothing to see of it" in message
    assert "--size" not in message
    assert "or a machine that is off (--model)" in message
    model.write_text('{"parameters_mm": {"d_rho_x": 1.0}}')
    assert glidecal("simulate", "--model", model, *effect, "-o", out).status == 0
