"""What a Hexa Slide's procedures see: on machines drawn from nothing, and in exact arithmetic."""

from __future__ import annotations

import os
from functools import cache
from itertools import chain, combinations
from types import SimpleNamespace

import numpy as np
import pytest

from calib.arrays import FloatArray
from calib.design.identifiability import analyse
from calib.hexaslide.geometry import ENCODERS, HexaSlide
from calib.hexaslide.planning import (
    PaperRule,
    enough_postures,
    fewest_postures,
    reachable,
    sensitivity,
)
from calib.hexaslide.procedures import COMPONENTS, ENDS, Procedure, ProcedureKind
from protocols.hexaslide import load_hexaslide
from tests.calib.hexaslide import prime_field as exact
from tests.calib.hexaslide.hexaslide_draws import SHAPES, drawn_machine
from tests.conftest import first_quick

FUZZ = bool(os.environ.get("GLIDECAL_FUZZ"))
SEEDS = 100 if FUZZ else 17
"""For each of six shapes: 102 machines; with GLIDECAL_FUZZ 600."""

LEAST_GAP = 1e8 if FUZZ else 1e9
"""Among 300 machines one shows a combination so weakly that its gap is 6e8."""

RANKS = {
    ProcedureKind.POSE_INVERSE: (49, 49),
    ProcedureKind.POSE_FORWARD: (49, 49),
    ProcedureKind.POSITION: (46, 49),
    ProcedureKind.CONSTRAINT_LINK: (48, 55),
}
ROTATIONS = [f"platform frame turned about its {axis}" for axis in "XYZ"]
SHIFTS = [f"platform frame shifted along its {axis}" for axis in "XYZ"]
LOST = {
    ProcedureKind.POSITION: ROTATIONS,
    ProcedureKind.CONSTRAINT_LINK: [*ROTATIONS, *SHIFTS, "base turned about X"],
}
EXACT_COUNT = 120
EXACT_SHAPES = ("any", "planar platform", "planar base", "parallel rails", "flat", "h60")


def subsets(names: tuple[str, ...], least: int) -> list[tuple[str, ...]]:
    sizes = range(least, len(names) + 1)
    return list(chain.from_iterable(combinations(names, size) for size in sizes))


MEASURED = subsets(COMPONENTS, 1)
KNOWN = subsets(tuple(ENDS), 0)


def example() -> HexaSlide:
    machine = load_hexaslide()
    return machine.whole()


@pytest.mark.parametrize("shape", first_quick(SHAPES))
def test_ranks_gaps_and_lost_motions_of_machines_drawn_from_nothing(shape: str) -> None:
    for seed in range(SEEDS):
        machine = drawn_machine(seed, shape)
        for kind, (rank, count) in RANKS.items():
            procedure = Procedure.of(kind)
            slopes = sensitivity(procedure, machine, enough_postures(procedure, machine))
            analysis = analyse(slopes)
            assert (analysis.rank, len(analysis.names)) == (rank, count), (seed, kind)
            scaled = slopes.jacobian / np.linalg.norm(slopes.jacobian, axis=0)
            _, singular, turned = np.linalg.svd(scaled, full_matrices=False)
            if rank == count:
                assert singular[-1] > 1e-9 * singular[0]
                continue
            assert singular[rank - 1] > LEAST_GAP * singular[rank], (seed, kind)
            assert [direction.combination for direction in analysis.unseen] == LOST[kind]
            expected = written_out(machine, kind, analysis.names)
            assert sine(analysis.unseen_vectors, expected) < 1e-8
            own_scaled = expected * np.linalg.norm(slopes.jacobian, axis=0)
            assert sine(turned[rank:], own_scaled) < 1e-6


def written_out(machine: HexaSlide, kind: ProcedureKind, names: tuple[str, ...]) -> FloatArray:
    """The lost motions as changes of the parameters, from the geometry alone."""
    geometry, link = machine.geometry, machine.link
    assert link is not None
    rows = []
    for axis in np.eye(3):
        turn = {f"B{k + 1}": np.cross(axis, geometry.platform[k]) for k in range(6)}
        rows.append(turn | {"c": np.cross(axis, link.platform_end)})
    if kind is ProcedureKind.CONSTRAINT_LINK:
        rows += [{f"B{k + 1}": axis for k in range(6)} | {"c": axis} for axis in np.eye(3)]
        about = np.array([1.0, 0.0, 0.0])
        base = {f"A{k + 1}": np.cross(about, geometry.base[k]) for k in range(6)}
        base |= {f"a{k + 1}": np.cross(about, geometry.rails[k]) for k in range(6)}
        rows.append(base | {"d": np.cross(about, link.base_end)})
    flat = [
        {f"{name[0]}{axis}{name[1:]}": move[k] for name, move in row.items()
         for k, axis in enumerate("xyz")}
        for row in rows
    ]  # fmt: skip
    return np.array([[row.get(name, 0.0) for name in names] for row in flat])


def sine(first: FloatArray, second: FloatArray) -> float:
    """Of the largest angle between spaces of equally many rows."""
    assert first.shape == second.shape
    first_basis, second_basis = np.linalg.qr(first.T)[0], np.linalg.qr(second.T)[0]
    return float(np.linalg.norm(first_basis - second_basis @ (second_basis.T @ first_basis), 2))


class Exactly:
    """Rows of one machine modulo p."""

    def __init__(self, shape: str, levels: dict[int, int] | None = None) -> None:
        generator = np.random.default_rng(5)
        self.machine = exact.h60() if shape == "h60" else exact.random_machine(generator, shape)
        self.at = exact.postures(self.machine, EXACT_COUNT, generator, levels=levels)
        self.sphere = exact.postures(self.machine, EXACT_COUNT, generator, bar=4321)
        self.sliders = exact.free_columns(exact.slider_rows(self.machine, self.at)[1])
        self.moved = exact.free_columns(exact.moved(self.machine, self.at))
        self.bar = exact.free_columns(exact.link_rows(self.machine, self.at))

    def rows(self, procedure: Procedure) -> exact.Field:
        """Postures, then values, then parameters."""
        if procedure.kind is ProcedureKind.POSE_INVERSE:
            return self.sliders
        if procedure.kind is ProcedureKind.CONSTRAINT_LINK:
            return self.bar[:, None, unknown(procedure)]
        return self.moved[:, [COMPONENTS.index(name) for name in procedure.measured]]

    def rank(self, procedure: Procedure) -> int:
        return exact.rank(self.rows(procedure))

    def fewest(self, procedure: Procedure) -> int:
        rows, low, high = self.rows(procedure), 1, EXACT_COUNT
        full_rank = exact.rank(rows)
        while low < high:
            middle = (low + high) // 2
            enough = exact.rank(rows[:middle]) == full_rank
            low, high = (low, middle) if enough else (middle + 1, high)
        return low


def unknown(procedure: Procedure) -> list[int]:
    """Columns of the 49 and of what is not known of the link, counted here once more."""
    unknowns = list(range(49))
    unknowns += [] if "c" in procedure.known else [49, 50, 51]
    unknowns += [] if "d" in procedure.known else [52, 53, 54]
    return unknowns + ([] if "length" in procedure.known else [55])


@cache
def exactly(shape: str) -> Exactly:
    return Exactly(shape)


def test_the_field_is_one_and_has_the_roots_that_are_used() -> None:
    assert all(exact.P % k for k in range(2, int(exact.P**0.5) + 2))
    assert exact.P % 12 == 11
    numbers = np.array([2, 3, 12345, exact.P - 1])
    assert (numbers * exact.inverse(numbers) % exact.P == 1).all()
    assert exact.root(np.array(3))[1]
    assert exact.rank(np.array([[1, 2, 3], [2, 4, 6], [1, 0, exact.P - 1]])) == 2


@pytest.mark.parametrize("shape", first_quick(EXACT_SHAPES))
def test_ranks_of_the_four_procedures_are_exact(shape: str) -> None:
    prime = exactly(shape)
    for kind, (rank, count) in RANKS.items():
        rows = prime.rows(Procedure.of(kind))
        assert (exact.rank(rows), rows.shape[-1]) == (rank, count)
    all_rows = exact.link_rows(prime.machine, prime.at)
    assert exact.rank(all_rows[:, :-1]) == 48  # what the base frame fixes, counted too
    sphere = exact.free_columns(exact.link_rows(prime.machine, prime.sphere))
    for fixed_frames in KNOWN:
        procedure = Procedure.of("constraint-link", known=fixed_frames)
        assert exact.rank(sphere[:, unknown(procedure)]) == prime.rank(procedure)


@pytest.mark.parametrize("shape", first_quick(["any", "h60"]))
def test_every_measured_subset_has_the_exact_rank(shape: str) -> None:
    machine = example() if shape == "h60" else drawn_machine(1, shape)
    assert len(MEASURED) == 63
    for measured in MEASURED:
        procedure = Procedure.of("pose-forward", measured)
        analysis = reachable(procedure, machine)
        assert analysis.rank == exactly(shape).rank(procedure), measured
        # whatever is lost has a name
        assert all(
            "frame" in direction.combination or "base" in direction.combination
            for direction in analysis.unseen
        )


@pytest.mark.parametrize("shape", ["any", "h60"])
@pytest.mark.parametrize(
    "fixed_frames", KNOWN, ids=lambda fixed_frames: "-".join(fixed_frames) or "none"
)
def test_whatever_is_known_of_the_link_the_rank_is_exact(
    shape: str, fixed_frames: tuple[str, ...]
) -> None:
    machine = example() if shape == "h60" else drawn_machine(1, shape)
    procedure = Procedure.of("constraint-link", known=fixed_frames)
    analysis = reachable(procedure, machine)
    assert analysis.rank == exactly(shape).rank(procedure)
    names = [direction.combination for direction in analysis.unseen]
    assert all("frame" in name or "base" in name for name in names)
    assert ("base turned about X" in names) == ("d" not in fixed_frames)
    assert [name for name in names if "shifted" in name] == ([] if "c" in fixed_frames else SHIFTS)
    assert len([name for name in names if "platform frame turned" in name]) == 3


BESIDE_THE_LINK = {
    ("theta",): 51,
    ("theta", "psi"): 51,
    ("phi",): 52,
    ("theta", "psi", "phi"): 52,
    ("x", "y", "z"): 52,
    COMPONENTS: 55,
}
"""Two tilts give the three motions back that they feel, phi the turn about Z as well, which needs
no other; only places show where the platform's frame is.
"""


@pytest.mark.parametrize("shape", ["any", "h60"])
@pytest.mark.parametrize(("measured", "rank"), BESIDE_THE_LINK.items(), ids=str)
def test_what_is_measured_beside_the_link_has_the_exact_rank(
    shape: str, measured: tuple[str, ...], rank: int
) -> None:
    procedure = Procedure.of("constraint-link", measured)
    machine = example() if shape == "h60" else drawn_machine(1, shape)
    analysis = reachable(procedure, machine)
    assert (analysis.rank, len(analysis.names)) == (rank, 55)
    assert all("frame" in direction.combination for direction in analysis.unseen)
    prime = exactly(shape)
    link = prime.bar[:, None, unknown(Procedure.of("constraint-link"))]
    places = prime.moved[:, [COMPONENTS.index(name) for name in measured]]
    padding = np.zeros((*places.shape[:2], 6), dtype=np.int64)
    both_kinds = np.concatenate([link, np.concatenate([places, padding], axis=-1)], axis=1)
    assert exact.rank(both_kinds) == rank


ENCODED = {
    ("pose-forward", ("turn1",)): (43, 50, 43),
    ("pose-forward", ("swing1",)): (43, 50, 43),
    ("pose-forward", ("turn1", "swing1")): (44, 51, 22),
    ("pose-forward", ("x", "y", "z", "turn1", "swing1")): (48, 51, 11),
    ("pose-forward", ("theta", "psi", "turn2", "turn5")): (47, 51, 12),
    ("pose-forward", ENCODERS[::2]): (48, 55, 8),
    ("constraint-link", ("swing4",)): (49, 56, 25),
    ("constraint-link", ("turn2", "theta", "psi")): (52, 56, 13),
}
"""Rank, parameters and fewest postures: encoders find their own zeros and no frame."""


@pytest.mark.parametrize(("options", "expected"), ENCODED.items(), ids=str)
def test_encoders_in_the_joints_have_the_exact_rank(
    options: tuple[str, tuple[str, ...]], expected: tuple[int, int, int]
) -> None:
    procedure = Procedure.of(*options)
    slopes = reachable(procedure, example())
    assert (slopes.rank, len(slopes.names)) == expected[:2]
    assert all(
        "frame" in direction.combination or "base" in direction.combination
        for direction in slopes.unseen
    )
    assert fewest_postures(procedure, example()) == expected[2]
    prime, good = exactly("h60"), np.ones(EXACT_COUNT, dtype=np.bool_)
    encoders = [name for name in procedure.measured if name in ENCODERS]
    width, blocks = len(procedure.parameters), []
    link = procedure.kind is ProcedureKind.CONSTRAINT_LINK
    if link:
        blocks.append(prime.bar[:, unknown(procedure)])
    for name in procedure.measured:
        rows = np.zeros((EXACT_COUNT, width), dtype=np.int64)
        if name in COMPONENTS:
            rows[:, :49] = prime.moved[:, COMPONENTS.index(name)]
        else:
            wide, there = exact.joint_rows(prime.machine, prime.at, int(name[-1]) - 1, name[:-1])
            rows[:, :49] = exact.free_columns(wide[:, :54])
            rows[:, width - len(encoders) + encoders.index(name)] = wide[:, 54]
            good &= there
        blocks.append(rows)
    if link:
        blocks[0] = np.pad(blocks[0], ((0, 0), (0, width - blocks[0].shape[1])))
    assert good.sum() >= expected[2]
    assert exact.rank(np.stack(blocks, axis=1)[good]) == expected[0]


@pytest.mark.parametrize(
    "procedure",
    [
        *(Procedure.of(kind) for kind in ProcedureKind),
        *(Procedure.of("pose-forward", MEASURED[k]) for k in (0, 3, 5, 8, 12, 22, 30, 41, 57)),
        *(Procedure.of("constraint-link", known=fixed_frames) for fixed_frames in KNOWN[::3]),
    ],
    ids=lambda procedure: "-".join((procedure.kind, *procedure.measured, *procedure.known)),
)
def test_fewest_postures_are_exact(procedure: Procedure) -> None:
    assert fewest_postures(procedure, example()) == exactly("h60").fewest(procedure)


@pytest.mark.parametrize(
    ("constants", "ranks"),
    first_quick(
        [((3, 4, 5), (36, 36, 32, 29)), ((3, 4), (45, 45, 42, 42)), ((5,), None), ((2,), None)],
        several=True,
    ),
)
def test_postures_too_much_alike_lose_what_exact_arithmetic_says(
    constants: tuple[int, ...], ranks: tuple[int, ...] | None
) -> None:
    """Coordinates held at zero: translations only lose most, a constant phi or z nothing."""
    machine, prime = example(), Exactly("any", dict.fromkeys(constants, 0))
    for k, kind in enumerate(ProcedureKind):
        procedure = Procedure.of(kind)
        postures = enough_postures(procedure, machine)
        postures[:, constants] = machine.box.centre[list(constants)]
        rank = analyse(sensitivity(procedure, machine, postures)).rank
        expected = RANKS[kind][0] if ranks is None else ranks[k]
        assert rank == prime.rank(procedure) == expected


@pytest.mark.parametrize(
    ("counted", "rows", "decided"),
    [(46, 100, "geometry"), (49, 49, "parameters"), (40, 40, "rows"), (41, 60, "postures")],
)
def test_a_count_of_identifiable_parameters_says_what_decided_it(
    counted: int, rows: int, decided: str
) -> None:
    """Of 49 parameters no readings see more than 46."""
    seen = SimpleNamespace(counted=counted, reachable_rank=46, parameter_count=49, row_count=rows)
    assert vars(PaperRule)["decided_by"].fget(seen) == decided
