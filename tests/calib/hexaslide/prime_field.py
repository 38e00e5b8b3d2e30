"""Ranks of Hexa Slide procedures in exact arithmetic modulo a prime; shares nothing with calib.

A machine and its postures are drawn modulo p so that every constraint holds exactly: directions and
rotations from rational half-angles, sliders from square roots where these exist. Derivatives come
from dual numbers. No rounding, no threshold: a rank found here is at most the true generic one and
differs from it with a chance of about 1e-6. Rows may be scaled freely: half-angles stand for angles
and squares for lengths.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.int64]
"""Numbers from 0 to P - 1; products stay below 2^62."""

P = 2_147_483_579
"""A prime just below 2^31 that is 11 modulo 12: half of all numbers have roots, and 3 has one."""

CHAINS = 6
PER_CHAIN = 9
FIXED = (3, 4, 5, 13, 14)
"""A1 = 0, y and z of A2 = 0, in chains of B, A, ax, ay, l."""


def power(base: Field, exponent: int) -> Field:
    product, square = np.ones_like(base), base % P
    while exponent:
        if exponent & 1:
            product = product * square % P
        square, exponent = square * square % P, exponent >> 1
    return product


def inverse(value: Field) -> Field:
    assert (value % P != 0).all()
    return power(value, P - 2)


def root(square: Field) -> tuple[Field, NDArray[np.bool_]]:
    """A root where there is one, and whether there is."""
    square_root = power(square, (P + 1) // 4)
    return square_root, square_root * square_root % P == square % P


def fraction(above: int, below: int) -> Field:
    return np.array(above % P) * inverse(np.array(below)) % P


@dataclass(frozen=True, eq=False)
class Dual:
    """Values of any shape and their derivatives, one more axis in front."""

    value: Field
    slopes: Field

    def __add__(self, operand: Dual) -> Dual:
        return Dual((self.value + operand.value) % P, (self.slopes + operand.slopes) % P)

    def __sub__(self, operand: Dual) -> Dual:
        return Dual((self.value - operand.value) % P, (self.slopes - operand.slopes) % P)

    def __mul__(self, operand: Dual) -> Dual:
        slopes = self.value * operand.slopes % P + operand.value * self.slopes % P
        return Dual(self.value * operand.value % P, slopes % P)

    def over(self, operand: Dual) -> Dual:
        below = inverse(operand.value)
        slopes = (self.slopes - self.value * below % P * operand.slopes) % P * below % P
        return Dual(self.value * below % P, slopes)

    def rooted(self, value: Field) -> Dual:
        """The root that has this value."""
        assert (value * value % P == self.value).all()
        return Dual(value, self.slopes * inverse(2 * value % P) % P)


Vector = tuple[Dual, Dual, Dual]


def dot(a: Vector, b: Vector) -> Dual:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def plain(value: Field | int, count: int, like: Field) -> Dual:
    """A number without derivatives."""
    full = np.broadcast_to(np.asarray(value, dtype=np.int64) % P, like.shape)
    return Dual(np.array(full), np.zeros((count, *like.shape), dtype=np.int64))


def turned(halves: Sequence[Dual], point: Vector) -> Vector:
    """``Ry Rx Rz`` times the point, from tangents of the half-angles theta, psi, phi."""
    unity = plain(1, len(halves[0].slopes), halves[0].value)
    for axis, half in ((2, halves[2]), (0, halves[1]), (1, halves[0])):
        square = half * half
        below = unity + square
        cosine, sine = (unity - square).over(below), (half + half).over(below)
        first, second = (axis + 1) % 3, (axis + 2) % 3
        parts = list(point)
        parts[first] = cosine * point[first] - sine * point[second]
        parts[second] = sine * point[first] + cosine * point[second]
        point = (parts[0], parts[1], parts[2])
    return point


@dataclass(frozen=True, eq=False)
class Machine:
    """Chains ``(6, 3)`` and ``(6,)``, ends of the constraint link ``(3,)``."""

    platform: Field
    base: Field
    rails: Field
    links: Field
    platform_end: Field
    base_end: Field


def random_machine(generator: np.random.Generator, shape: str = "any") -> Machine:
    """``shape``: any, or with a planar platform, a planar base, parallel rails, all three: flat."""
    platform = _draw(generator, (CHAINS, 3))
    base = _draw(generator, (CHAINS, 3))
    base[0] = base[1, 1:] = 0
    rails = _directions(_draw(generator, (CHAINS, 2)))
    if shape in {"planar platform", "flat"}:
        platform[:, 2] = 0
    if shape in {"planar base", "flat"}:
        base[:, 2] = 0
    if shape in {"parallel rails", "flat"}:
        rails = np.tile(rails[0], (CHAINS, 1))
    ends = _draw(generator, (2, 3))
    return Machine(platform, base, rails, _draw(generator, (CHAINS,)), *ends)


def h60() -> Machine:
    """The assumed machine, from how it is constructed: a third of a turn repeats its pairs."""
    three, there = root(np.array(3))
    assert there
    half = inverse(np.array(2))
    sine = three * half % P
    third = np.array([[-half, -sine, 0], [sine, -half, 0], [0, 0, 1]]) % P
    centre = np.array([fraction(1, 10), fraction(-8, 10), 0])
    starts = np.array([[0, 0, 0], [fraction(2, 10), 0, 0]]) - centre
    joints = np.array([[fraction(-15, 100), fraction(1, 4), 0], [fraction(15, 100), half // 1, 0]])
    joints[1, 1] = fraction(1, 4)
    rail = np.array([0, -half, -sine]) % P
    pairs: list[tuple[Field, Field, Field]] = []
    for _ in range(3):
        pairs.append((starts, joints, np.tile(rail, (2, 1))))
        starts, joints, rail = _times(third, starts), _times(third, joints), _times(third, rail)
    base, platform, rails = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    return Machine(
        platform % P,
        (base + centre) % P,
        rails,
        np.tile(fraction(88, 100), CHAINS),
        np.array([0, 0, fraction(-5, 100)]),
        np.array([0, fraction(-8, 10), fraction(-165, 100)]),
    )


def _times(matrix: Field, points: Field) -> Field:
    """Matrix ``(3, 3)`` times each point ``(..., 3)``."""
    return np.asarray((points[..., None, :] % P * matrix % P).sum(axis=-1) % P)


def _draw(generator: np.random.Generator, shape: tuple[int, ...]) -> Field:
    return generator.integers(1, P, shape, dtype=np.int64)


def _directions(parts: Field) -> Field:
    """Unit vectors ``(n, 3)`` by stereographic projection of ``(n, 2)``."""
    squares = (parts * parts % P).sum(axis=1) % P
    below = inverse((1 + squares) % P)[:, None]
    level = 2 * parts % P * below % P
    return np.column_stack([level, (squares - 1) % P * below[:, 0] % P])


@dataclass(frozen=True, eq=False)
class Postures:
    """x, y, z and half-angles ``(p, 6)`` with sliders ``(p, 6)`` and the bar's length ``(p,)``."""

    coordinates: Field
    sliders: Field
    lengths: Field


def postures(
    machine: Machine,
    count: int,
    generator: np.random.Generator,
    *,
    levels: dict[int, int] | None = None,
    bar: int | None = None,
) -> Postures:
    """Postures at which all roots exist; ``levels`` holds coordinates at a value.

    With a ``bar`` all of them lie where the constraint link has that length.
    """
    batches: list[tuple[Field, Field, Field]] = []
    accepted_count = 0
    while accepted_count < count:
        drawn = _draw(generator, (20_000, 6))
        for coordinate, value in (levels or {}).items():
            drawn[:, coordinate] = value
        good = np.ones(len(drawn), dtype=np.bool_)
        if bar is not None:
            drawn, good = _on_sphere(machine, drawn, bar)
        sliders, there = _sliders(machine, drawn)
        length, measurable = root(_square(_apart(machine, drawn)))
        good &= there & measurable
        batches.append((drawn[good], sliders[good], length[good]))
        accepted_count += int(good.sum())
    parts = [np.concatenate(column)[:count] for column in zip(*batches, strict=True)]
    return Postures(parts[0], parts[1], np.full(count, bar) if bar is not None else parts[2])


def _seen_from(drawn: Field, point: Field) -> list[Field]:
    """Coordinates of a point of the platform."""
    nothing = np.zeros((0, *drawn.shape[:1]), dtype=np.int64)
    halves = [Dual(drawn[:, 3 + k], nothing) for k in range(3)]
    x, y, z = (plain(part, 0, drawn[:, 0]) for part in point)
    return [(drawn[:, k] + part.value) % P for k, part in enumerate(turned(halves, (x, y, z)))]


def _square(parts: Iterable[Field]) -> Field:
    return np.asarray(sum((part * part % P for part in parts), start=np.array(0)) % P)


def _apart(machine: Machine, drawn: Field) -> list[Field]:
    turned_end = _seen_from(drawn, machine.platform_end)
    return [(turned_end[k] - machine.base_end[k]) % P for k in range(3)]


def _on_sphere(machine: Machine, drawn: Field, bar: int) -> tuple[Field, NDArray[np.bool_]]:
    """Moved along z so that the ends of the link are ``bar`` apart."""
    x, y, z = _apart(machine, drawn)
    height, there = root((bar * bar - x * x % P - y * y % P) % P)
    moved = drawn.copy()
    moved[:, 2] = (drawn[:, 2] - z + height) % P
    return moved, there


def _sliders(machine: Machine, drawn: Field) -> tuple[Field, NDArray[np.bool_]]:
    """Roots of ``|reach - slider rail|² = link²``."""
    sliders = np.empty((len(drawn), CHAINS), dtype=np.int64)
    good = np.ones(len(drawn), dtype=np.bool_)
    for k in range(CHAINS):
        turned_end = _seen_from(drawn, machine.platform[k])
        reach = [(turned_end[j] - machine.base[k, j]) % P for j in range(3)]
        along = sum(reach[j] * machine.rails[k, j] % P for j in range(3)) % P
        square = (machine.links[k] ** 2 - _square(reach) + along * along) % P
        lean, there = root(square)
        sliders[:, k] = (along - lean) % P
        good &= there
    return sliders, good


def slider_rows(machine: Machine, at: Postures) -> tuple[Field, Field]:
    """Derivatives of the six constraints by posture ``(p, 6, 6)`` and parameters ``(p, 6, 54)``."""
    count = len(at.coordinates)
    by_posture = np.empty((count, CHAINS, 6), dtype=np.int64)
    by_parameter = np.zeros((count, CHAINS, CHAINS, PER_CHAIN), dtype=np.int64)
    for k in range(CHAINS):
        numbers = [*machine.platform[k], *machine.base[k], *machine.rails[k, :2], machine.links[k]]
        columns = np.column_stack([at.coordinates, np.tile(numbers, (count, 1))])
        place, halves, constants = _variables(columns)
        ax, ay = constants[6], constants[7]
        unity = plain(1, 15, at.sliders[:, k])
        rail = (ax, ay, (unity - ax * ax - ay * ay).rooted(_many(machine.rails[k, 2], count)))
        slider = plain(at.sliders[:, k], 15, at.sliders[:, k])
        turned_end = turned(halves, (constants[0], constants[1], constants[2]))
        joint = (place[0] + turned_end[0], place[1] + turned_end[1], place[2] + turned_end[2])
        away = (slider * rail[0], slider * rail[1], slider * rail[2])
        link = minus(minus(joint, (constants[3], constants[4], constants[5])), away)
        miss = dot(link, link) - constants[8] * constants[8]
        assert (miss.value == 0).all()
        by_posture[:, k] = miss.slopes[:6].T
        by_parameter[:, k, k] = miss.slopes[6:].T
    return by_posture, by_parameter.reshape(count, CHAINS, -1)


def _many(value: Field, count: int) -> Field:
    return np.full(count, value)


def _variables(columns: Field) -> tuple[list[Dual], list[Dual], list[Dual]]:
    """Each column a variable of its own: place, half-angles, and the rest."""
    count = columns.shape[1]
    slopes = np.repeat(np.eye(count, dtype=np.int64)[:, :, None], len(columns), axis=2)
    duals = [Dual(columns[:, k] % P, slopes[:, k]) for k in range(count)]
    return duals[:3], duals[3:6], duals[6:]


def moved(machine: Machine, at: Postures) -> Field:
    """Derivatives of the postures by the parameters ``(p, 6, 54)``, sliders kept."""
    by_posture, by_parameter = slider_rows(machine, at)
    return _solved(by_posture, -by_parameter % P)


def _solved(matrix: Field, right: Field) -> Field:
    """Six equations at each posture, by elimination without exchange."""
    system = np.concatenate([matrix, right], axis=2)
    for k in range(6):
        system[:, k] = system[:, k] * inverse(system[:, k, k])[:, None] % P
        for row in range(6):
            if row != k:
                system[:, row] -= system[:, row, k, None] * system[:, k] % P
                system[:, row] %= P
    return np.asarray(system[:, :, 6:])


def link_rows(machine: Machine, at: Postures) -> Field:
    """Derivatives of the bar's square less its length's ``(p, 61)``: chains, then c, d, length."""
    count = len(at.coordinates)
    numbers = [*machine.platform_end, *machine.base_end]
    columns = np.column_stack([at.coordinates, np.tile(numbers, (count, 1)), at.lengths])
    place, halves, constants = _variables(columns)
    turned_end = turned(halves, (constants[0], constants[1], constants[2]))
    end = (place[0] + turned_end[0], place[1] + turned_end[1], place[2] + turned_end[2])
    apart = minus(end, (constants[3], constants[4], constants[5]))
    miss = dot(apart, apart) - constants[6] * constants[6]
    assert (miss.value == 0).all()
    shares = miss.slopes[:6].T
    by_chains = (shares[:, :, None] * moved(machine, at) % P).sum(axis=1) % P
    return np.column_stack([by_chains, miss.slopes[6:].T])


def joint_rows(
    machine: Machine, at: Postures, chain: int, name: str
) -> tuple[Field, NDArray[np.bool_]]:
    """Derivatives of an encoder in the joint on a carriage ``(p, 55)``: chains, then its zero; and
    which postures have the root that a swing needs.

    The turn of the link about the rail from any direction across it, the swing by its cosine; each
    row is multiplied by what makes it rational, its zero as well.
    """
    count = len(at.coordinates)
    numbers = [*machine.platform[chain], *machine.base[chain], *machine.rails[chain, :2]]
    columns = np.column_stack([at.coordinates, np.tile(numbers, (count, 1))])
    place, halves, constants = _variables(columns)
    unity = plain(1, 14, at.sliders[:, chain])
    ax, ay = constants[6], constants[7]
    rail = (ax, ay, (unity - ax * ax - ay * ay).rooted(_many(machine.rails[chain, 2], count)))
    slider = plain(at.sliders[:, chain], 14, at.sliders[:, chain])
    turned_end = turned(halves, (constants[0], constants[1], constants[2]))
    joint = (place[0] + turned_end[0], place[1] + turned_end[1], place[2] + turned_end[2])
    away = (slider * rail[0], slider * rail[1], slider * rail[2])
    link = minus(minus(joint, (constants[3], constants[4], constants[5])), away)
    zero = plain(0, 14, at.sliders[:, chain])
    if name == "turn":
        first = (ay, zero - ax, zero)
        # as long as `first`, for the rail is a unit vector
        second = (
            rail[1] * first[2] - rail[2] * first[1],
            rail[2] * first[0] - rail[0] * first[2],
            rail[0] * first[1] - rail[1] * first[0],
        )
        x, y = dot(link, first), dot(link, second)
        slopes = (x.value * y.slopes % P - y.value * x.slopes % P) % P
        own_zero = (x.value * x.value % P + y.value * y.value % P) % P
        good = np.ones(count, dtype=np.bool_)
    else:
        along, square = dot(link, rail), dot(link, link)
        across, good = root((square - along * along).value)
        # d(swing) = (along d(square) / 2 - square d(along)) / (square across)
        half = inverse(np.array(2))
        slopes = (along.value * half % P * square.slopes - square.value * along.slopes % P) % P
        own_zero = square.value * across % P
    by_parameter = np.zeros((count, CHAINS, PER_CHAIN), dtype=np.int64)
    by_parameter[:, chain, :8] = slopes[6:].T
    shares = slopes[:6].T
    by_chains = (shares[:, :, None] * moved(machine, at) % P).sum(axis=1) % P
    rows = (by_chains + by_parameter.reshape(count, -1)) % P
    return np.column_stack([rows, own_zero]), np.asarray(good, dtype=np.bool_)


def free_columns(rows: Field) -> Field:
    """Without what the base frame fixes."""
    return np.delete(rows, FIXED, axis=-1)


def rank(rows: Field) -> int:
    """By elimination with exchange of rows."""
    matrix = rows.reshape(-1, rows.shape[-1]) % P
    pivot_row = 0
    for column in range(matrix.shape[1]):
        pivots = np.flatnonzero(matrix[pivot_row:, column])
        if not len(pivots):
            continue
        matrix[[pivot_row, pivot_row + pivots[0]]] = matrix[[pivot_row + pivots[0], pivot_row]]
        top = matrix[pivot_row] * inverse(matrix[pivot_row, column]) % P
        below = matrix[pivot_row + 1 :]
        matrix[pivot_row + 1 :] = (below - below[:, column, None] * top % P) % P
        pivot_row += 1
        if pivot_row == len(matrix):
            break
    return pivot_row
