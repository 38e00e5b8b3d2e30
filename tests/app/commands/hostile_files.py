"""Files of a stranger: what the program reads, with something wrong in it, always alike for a seed.

Each case is a folder with one hostile file, and the verbs that read it.
"""

from __future__ import annotations

import json
import random
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from protocols.record import digest_of
from tests.conftest import ROOT, SAMPLES

Arguments = tuple[str, ...]
Node: TypeAlias = Any
"""A value of a JSON document."""

ESCAPES = "\x1b]0;owned\x07\x1b]52;c;cm0=\x07\x9b31m\u202eevil\u2066\u200b\x7f"

VALUES: tuple[Any, ...] = (
    *(None, True, False, "", "x" * 20_000, ESCAPES, "a\nverdict: OK\r\nb", "../../up", "/", "."),
    *("=1+1", "1e5", 1e300, -1e300, 1e-300, 5e-324, 1e308, -1, 0, -0.0, 0.5, 7, 1e5, 1e9),
    *(10**400, 2**63, float("nan"), float("inf"), [], {}, [0.0] * 5000, [[[]]], {"": None}),
)

NUMBERS_WITHIN = (
    *(0.0, -0.0, 1e-300, 5e-324, 1e-9, 1e-6, 0.001, 0.5, 1.0, -1.0, 100.0, 1000.0, 99_999.0),
    *(-99_999.0, 1e5, -1e5, 1e9, 310.2, -310.2, 60.0),
)
"""Among them what a bound lets through."""

TEXTS_WITHIN = ("", "x" * 20_000, ESCAPES, "a\nverdict: OK\r\nb", "/", ".", "=1+1", "x", "y", "z")

TOML_VALUES = (
    *("", "true", '""', "'" + "x" * 20_000 + "'", '"a\\nb"', '"\\u001b]0;owned\\u0007\\u009b"'),
    *("1e300", "-1e300", "1e-300", "5e-324", "1e308", "nan", "inf", "-1", "0", "-0.0", "0.5", "7"),
    *("9" * 400, "9" * 5000, "0x" + "f" * 5000, "[]", "[[]]", "[" * 3000, "{}", "1979-05-27"),
    *("[0.0, 0.0, 0.0]", "[1e-300, 0.0, 0.0]", "[" + "0.25, " * 9000 + "]", '["x"]', '["zero"]'),
    *('"/"', '"../../up"', "{a = {a = 1}}", "'''\n[schema]\n'''"),
)

TOML_LINES = (
    *("a" + ".a" * 3000 + " = 1", '"a b"' + '."a b"' * 3000 + " = 1", "[" + "a." * 5000 + "a]"),
    *("\x00", "\ufeff", "name = 1\nname = 2", "[[indicator]]\nprofile = 'none'", "cycles = 100"),
    *("stations = [0.1, 0.2, 0.3, 0.4]", "x = [" + "[" * 90 + "]" * 90 + "]", "= 1", "[", "\ud7ff"),
)

EFFECT_FILES = (
    *("EFFECTS = 1", "EFFECTS = (1, 2)", "", "raise SystemExit(3)", "1/0", "(" * 3000, "\x00"),
    *("x = " + "-" * 50_000 + "1", "EFFECTS = ()", "import nothing_of_that_name"),
)

LAW = """
from dataclasses import dataclass
from calib.tripod.effects.effect import EffectParameter, Kind
from calib.tripod.effects.effect import at_mount, mounts
from calib.tripod.pipeline import Stage

@dataclass(frozen=True)
class Law:
    id: str = "hostile"
    title: str = {title}
    kind: Kind = Kind.INDICATOR
    stage: Stage = Stage.READING
    parameters: tuple[EffectParameter, ...] = (EffectParameter("bend", "mm", {tolerance}),)
    invariances: tuple[str, ...] = ()
    controller: str = ""
    def places(self, taken):
        return mounts(taken)
    def change(self, passing, flow, place, values):
        return passing + values[0] * {factor} * at_mount(flow, place)

EFFECTS = (Law(),)
"""
NUMBER = re.compile(r"(?<![\w.])-?\d+\.\d+(?![\w.])")
NUMBERS = ("1.0", "1e-300", "1e300", "5e-324", "float('nan')", "float('inf')", "0.0", "-1.0", "'x'")


@dataclass(frozen=True)
class Case:
    """The verbs to run in the folder, and environment variables for them."""

    runs: tuple[Arguments, ...]
    surroundings: dict[str, str]


def hostile_case(seed: int, folder: Path) -> Case:
    """Write the files of this seed into the folder."""
    chance = random.Random(seed)
    kind = KINDS[seed % len(KINDS)]
    return kind(chance, folder)


def _record(chance: random.Random, folder: Path) -> Case:
    names = ("experiment_1_six", "experiment_2_twelve", "simulated_zero-max-min")
    text = (SAMPLES / f"{chance.choice(names)}.jsonl").read_text()
    events = [json.loads(line) for line in text.splitlines()]
    if chance.random() < 0.3:
        events = events[: chance.randint(1, len(events))]  # still open
    for _ in range(chance.choice((1, 1, 1, 2, 5))):
        _spoil(chance, chance.choice((events[0], chance.choice(events), events[-1])))
    path = folder / "s.jsonl"
    path.write_bytes(_bytes_spoilt(chance, chained(events)))
    name = path.name
    runs = (
        ("validate", name),
        ("replay", "--headless", name),
        ("replay", "--json", name),
        ("solve", name, "--method", "linear"),
        ("solve", "--json", name),
        ("compare", name, str(SAMPLES / "experiment_2_twelve.jsonl")),
        ("export", name, "--format", chance.choice(("csv", "json", "linuxcnc")), "-o", "out"),
        ("plan", name),
        ("run", "--continue", name, "--headless"),
    )
    return Case(tuple(chance.sample(runs, 3)), {})


def _machine(chance: random.Random, folder: Path) -> Case:
    source = (ROOT / "protocols/machines/orthoglide.toml").read_text()
    _toml(chance, folder / "m.toml", source)
    table = str(SAMPLES / "tables/experiment_2_twelve.csv")
    verb = ("identifiability", "orthoglide", "--procedure", "zero-max-min")
    runs: tuple[Arguments, ...] = (
        ("run", "--dry-run", "--machine", "m.toml"),
        ("simulate", "--machine", "m.toml", "-o", "s.jsonl"),
        ("import", table, "--machine", "m.toml", "-o", "t.jsonl"),
        (*verb, "--machine-file", "m.toml"),
        ("solve", "s.jsonl"),
    )
    return Case(runs, {})


def _procedure(chance: random.Random, folder: Path) -> Case:
    name = chance.choice(("zero-max-min", "two-station", "sweep"))
    _toml(chance, folder / "p.toml", (ROOT / f"protocols/procedures/{name}.toml").read_text())
    runs: tuple[Arguments, ...] = (
        ("run", "--dry-run", "--protocol", "p.toml"),
        ("simulate", "--protocol", "p.toml", "-o", "s.jsonl"),
        ("identifiability", "orthoglide", "--procedure", "p.toml"),
        ("solve", "s.jsonl", "--method", "linear"),
    )
    return Case(runs, {})


def _hexaslide(chance: random.Random, folder: Path) -> Case:
    _toml(chance, folder / "h.toml", (ROOT / "protocols/machines/hexaslide-h60.toml").read_text())
    common = ("hexaslide", "--procedure", "position", "--postures", "12")
    return Case((("identifiability", *common, "--machine-file", "h.toml"),), {})


def _postures(chance: random.Random, folder: Path) -> Case:
    rows = [["x_m", "y_m", "z_m", "theta_deg", "psi_deg", "phi_deg"], *(["0.0"] * 6,) * 12]
    _cells(chance, rows)
    text = "\n".join(map(",".join, rows))
    (folder / "p.csv").write_bytes(_bytes_spoilt(chance, text.encode("utf-8", "surrogatepass")))
    arguments = (
        "identifiability",
        "hexaslide",
        "--procedure",
        "position",
        "--posture-file",
        "p.csv",
    )
    return Case((arguments,), {})


def _model(chance: random.Random, folder: Path) -> Case:
    taper = {"value": 0.05, "unit": "mm/m", "standard_uncertainty": 0.01}
    provenance = {"sessions": ["s"], "digests": ["0"], "found": "2026-01-01T00:00:00Z"}
    entry = {"id": "leg_taper", "where": "xy", "parameters": {"taper": taper}}
    model: dict[str, Any] = {
        "schema": "glidecal.model/1",
        "machine": {"name": "m", "leg_length_mm": 310.25, "gravity": [0.0, 0.0, -1.0]},
        "parameters_mm": dict.fromkeys(("d_rho_x", "d_rho_y", "d_rho_z", "d_L_x"), 0.1),
        "effects": [{**entry, "provenance": provenance}],
        "history": [{"action": "added", "at": "2026-01-01T00:00:00Z", "why": "", "effect": entry}],
        "cautions": ["NOTE: one"],
    }
    for _ in range(chance.choice((1, 1, 1, 2, 5))):
        _spoil(chance, model)
    (folder / "m.json").write_bytes(_bytes_spoilt(chance, json.dumps(model).encode()))
    kinds = ("json", "csv", "model", "linuxcnc")
    runs: tuple[Arguments, ...] = (
        ("model", "m.json"),
        ("model", "m.json", "--json"),
        *(("export", "m.json", "--format", kind, "-o", f"out-{kind}") for kind in kinds),
        ("simulate", "--model", "m.json", "-o", "s.jsonl"),
        ("model", "m.json", "--remove", "leg_taper", "--why", "hostile"),
    )
    return Case(runs, {})


def _controller(chance: random.Random, folder: Path) -> Case:
    """A model with effects along the drives, and a controller's INI file."""
    play = {"value": 0.05, "unit": "mm"}
    scale = {"value": 0.2, "unit": "mm/m"}
    model: dict[str, Any] = {
        "schema": "glidecal.model/1",
        "parameters_mm": dict.fromkeys(("d_rho_x", "d_rho_y", "d_rho_z"), 0.1),
        "effects": [
            {"id": "backlash", "where": "x", "parameters": {"play": play}},
            {"id": "actuator_scale", "where": "y", "parameters": {"scale": scale}},
        ],
    }
    if chance.random() < 0.7:
        _spoil(chance, model)
    (folder / "m.json").write_text(json.dumps(model))
    joints = [f"[JOINT_{n}]\nHOME_OFFSET = {300 + n}\nHOME_LATCH_VEL = -1" for n in range(3)]
    kins = "[KINS]\nKINEMATICS = trivkins coordinates=XYZ\nJOINTS = 3"
    lines = "\n".join(["[TRAJ]\nLINEAR_UNITS = mm", kins, *joints]).splitlines()
    for _ in range(chance.choice((0, 1, 2, 5))):
        at = chance.randrange(len(lines))
        lines[at : at + chance.randint(0, 1)] = [chance.choice(LINES_OF_INI)]
    (folder / "m.ini").write_bytes(_bytes_spoilt(chance, "\n".join(lines).encode()))
    export = ("export", "m.json", "--ini", "m.ini")
    runs: tuple[Arguments, ...] = (
        (*export, "--format", "linuxcnc", "-o", "out-a"),
        (*export, "--format", "linuxcnc-kins", "-o", "out-b"),
        ("solve", str(SAMPLES / "simulated_zero-max-min.jsonl"), "--model", "m.json"),
    )
    return Case(runs, {})


LINES_OF_INI = (
    *(
        "#INCLUDE m.ini",
        "#INCLUDE /dev/zero",
        "#INCLUDE ..",
        "#INCLUDE $(touch pwned)",
        "#INCLUDE '",
    ),
    *(
        "#INCLUDE `touch pwned`",
        "#INCLUDE ~nobody/x",
        "[JOINT_0]",
        "[",
        "[]",
        "\\",
        "= 1",
        "HOME_OFFSET",
    ),
    *("HOME_OFFSET = 1e400", "HOME_OFFSET = nan", "HOME_OFFSET = " + "9" * 400, "LINEAR_UNITS = 0"),
    *("LINEAR_UNITS = 1e-300", "JOINTS = 1e9", "JOINTS = 3.7", "JOINTS = -1", "BACKLASH = 1e300"),
    *("COMP_FILE = \x1b]0;t\x07", "HOME_ABSOLUTE_ENCODER = 2", "HOME_LATCH_VEL = 1e-300"),
    *("KINEMATICS = x coordinates=XXYYZZ", "KINEMATICS = x coordinates=" + "A" * 500),
)


def _table(chance: random.Random, folder: Path) -> Case:
    text = (SAMPLES / "tables/experiment_2_twelve.csv").read_text()
    rows = [line.split(",") for line in text.splitlines()]
    _cells(chance, rows)
    spoilt = _bytes_spoilt(chance, "\n".join(map(",".join, rows)).encode("utf-8", "surrogatepass"))
    (folder / "t.csv").write_bytes(spoilt)
    runs = (
        ("import", "t.csv", "-o", "s.jsonl"),
        ("solve", "s.jsonl"),
        ("replay", "--headless", "s.jsonl"),
    )
    return Case(runs, {})


def _effect_file(chance: random.Random, folder: Path) -> Case:
    effects = folder / "effects"
    effects.mkdir()
    effect = LAW.format(
        title=repr(ESCAPES), tolerance=chance.choice(NUMBERS), factor=chance.choice(NUMBERS)
    )
    text = chance.choice((*EFFECT_FILES, effect, effect, effect))
    (effects / "e.py").write_text(text)
    simulate = ("simulate", "-o", "s.jsonl", "--effect", "hostile")
    aliases = ("diagnose", "--aliases", "--procedure", "zero-max-min")
    return Case((simulate, aliases), {"GLIDECAL_EFFECTS": str(effects)})


KINDS: tuple[Callable[[random.Random, Path], Case], ...] = (
    *(
        _record,
        _record,
        _record,
        _machine,
        _procedure,
        _model,
        _model,
        _controller,
        _table,
        _hexaslide,
    ),
    *(_postures, _effect_file),
)


def _spoil(chance: random.Random, document: dict[str, Any]) -> None:
    """One thing in it, at any depth: another value, gone, there twice or never heard of."""
    place, key = chance.choice(_places(document))
    match chance.randrange(8):
        case 0:
            del place[key]
        case 1 if isinstance(place, dict):
            place[chance.choice((ESCAPES, "", "__class__", "unknown"))] = chance.choice(VALUES)
        case 2 if isinstance(place, list):
            place.extend([place[key]] * chance.choice((1, 100)))
        case 3:
            place[key] = chance.choice(({"a": [place[key]] * 3}, *VALUES))
        case _:
            place[key] = _other(chance, place[key])


def _other(chance: random.Random, value: Node) -> Node:
    """Something of the same kind, which gets further than the first check."""
    if isinstance(value, str):
        return chance.choice(TEXTS_WITHIN)
    if isinstance(value, int):
        return chance.choice((0, 1, -1, 7, 100, 1_000_000, 10**400, not value))
    return chance.choice(NUMBERS_WITHIN if isinstance(value, float) else VALUES)


def _places(node: Node) -> list[tuple[Node, Node]]:
    """Every value within, as its container and its key."""
    keys = list(node) if isinstance(node, dict) else list(range(len(node)))
    places = [(node, key) for key in keys]
    for key in keys:
        if isinstance(node[key], dict | list):
            places += _places(node[key])
    return places or [({"": 0}, "")]


def chained(events: list[dict[str, Any]]) -> bytes:
    """The events as a record whose digests are right: an attacker has no trouble with them."""
    digest, lines = "0" * 64, []
    for number, event in enumerate(events, start=1):
        event |= {"line": number, "previous": digest}
        closed = event.get("event") == "closed"
        if closed:
            event["seal"] = ""
        line = json.dumps(event, separators=(",", ":")).encode()
        if closed:
            line = line.replace(b'"seal":""', f'"seal":"{digest_of(line)}"'.encode())
        lines.append(line)
        digest = digest_of(line)
    return b"\n".join(lines) + b"\n"


def _bytes_spoilt(chance: random.Random, content: bytes) -> bytes:
    """Mostly as it is; sometimes cut, with a byte that is no text, or nested without end."""
    at = chance.randrange(len(content) + 1)
    match chance.randrange(20):
        case 0:
            return content[:at]
        case 1:
            return content[:at] + chance.choice((b"\x00", b"\xff\xfe", b"\x1b[2J")) + content[at:]
        case 2:
            return content.replace(b"0", b"[" * 100_000, 1)
    return content


def _toml(chance: random.Random, path: Path, source: str) -> None:
    lines = source.splitlines()
    keyed = [k for k, line in enumerate(lines) if "=" in line and not line.startswith("#")]
    for k in chance.sample(keyed, min(len(keyed), chance.choice((1, 1, 1, 2, 4)))):
        key, value = lines[k].split("=", 1)
        if chance.random() < 0.3:
            value = chance.choice(TOML_VALUES)
        elif NUMBER.search(value):
            value = NUMBER.sub(lambda _: str(chance.choice(NUMBERS_WITHIN)), value, count=1)
        else:
            value = json.dumps(chance.choice(TEXTS_WITHIN))
        lines[k] = f"{key}= {value}"
    if chance.random() < 0.3:
        lines.insert(chance.randrange(len(lines) + 1), chance.choice(TOML_LINES))
    path.write_bytes(_bytes_spoilt(chance, "\n".join(lines).encode("utf-8", "surrogatepass")))


def _cells(chance: random.Random, rows: list[list[str]]) -> None:
    for _ in range(chance.choice((1, 2, 6))):
        row = chance.choice(rows)
        text = str(chance.choice((*VALUES, *NUMBERS)))[:30_000]
        texts = (text, "9" * 400, '"', "1,5", "1e-320", *map(str, NUMBERS_WITHIN))
        row[chance.randrange(len(row))] = chance.choice(texts)
