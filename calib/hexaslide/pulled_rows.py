"""Rows of a procedure with their derivatives by the postures pulled back, for long searches.

`calib.hexaslide.procedures` writes the same rows plainly. A search needs only the derivatives of
one number by the postures: given its derivatives by the rows, `Pull` gives them, at about the price
of the rows themselves, and derivatives of rows are never formed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from calib.errors import CalibrationError
from calib.hexaslide.geometry import CHAINS, ConstraintLink, Geometry
from calib.hexaslide.moving_frame import Bar, Chains, Turn
from calib.hexaslide.parameters import ALL_NAMES, END_NAMES, FREE
from calib.hexaslide.procedures import COMPONENTS, Kind, Procedure
from calib.observations import FloatArray

Pull = Callable[[FloatArray], FloatArray]
"""From a number's derivatives by rows ``(p, r, n)`` to those by the postures ``(p, 6)``."""

ALL = len(ALL_NAMES)
OF_LINK = len(END_NAMES) + 1
CHAIN = np.arange(CHAINS)


class RowMaker:
    """Rows of a procedure, seen in a basis ``(k, n)`` of its parameters."""

    def __init__(
        self,
        procedure: Procedure,
        geometry: Geometry,
        link: ConstraintLink | None,
        basis: FloatArray,
    ) -> None:
        self.procedure = procedure
        self.geometry = geometry
        self.link = link
        linked = procedure.kind is Kind.CONSTRAINT_LINK
        # what is fixed or known takes part as zeros: chains stay blocks of nine
        unknown = [*FREE, *(ALL + k for k in procedure.link_columns)] if linked else FREE
        self._basis = np.zeros((ALL + OF_LINK * linked, basis.shape[1]))
        self._basis[list(unknown)] = basis

    @property
    def width(self) -> int:
        """How many combinations of the parameters the basis has."""
        return self._basis.shape[1]

    def __call__(self, postures: FloatArray) -> tuple[FloatArray, Pull]:
        """Rows ``(p, r, n)`` at postures ``(p, 6)``, and their pull.

        Raises UnreachablePosture, and CalibrationError at a singular posture or without a link.
        """
        turn = Turn.at(postures[:, 3:])
        chains = Chains.at(self.geometry, postures, turn)
        if self.procedure.kind is Kind.POSE_INVERSE:
            return self._sliders(chains)
        try:
            held = np.asarray(np.linalg.inv(chains.by_posture), dtype=np.float64)
        except np.linalg.LinAlgError as problem:
            raise CalibrationError(
                "postures", "a singular one", "postures at which the sliders hold the platform"
            ) from problem
        if self.procedure.kind is not Kind.CONSTRAINT_LINK:
            return self._components(chains, held)
        if self.link is None:
            raise CalibrationError("constraint link", "none", "one in the machine file")
        return self._length(chains, held, Bar.at(self.link, postures, turn))

    def _sliders(self, chains: Chains) -> tuple[FloatArray, Pull]:
        full = np.zeros((len(chains.own), CHAINS, CHAINS, chains.own.shape[-1]))
        full[:, CHAIN, CHAIN] = chains.own

        def pull(weights: FloatArray) -> FloatArray:
            return chains.pull(self._blocks(weights)[0][:, CHAIN, CHAIN])

        return full.reshape(len(full), CHAINS, -1) @ self._basis, pull

    def _components(self, chains: Chains, held: FloatArray) -> tuple[FloatArray, Pull]:
        """The posture keeps the sliders: ``-held own``, ``held`` the inverse of ``by_posture``."""
        some = held[:, [COMPONENTS.index(name) for name in self.procedure.measured]]
        full = -some[..., None] * chains.own[:, None]

        def pull(weights: FloatArray) -> FloatArray:
            blocks = self._blocks(weights)[0]
            by_own = -(some[..., None] * blocks).sum(axis=1)
            by_some = -(blocks * chains.own[:, None]).sum(axis=-1)
            # d(inverse) = -inverse · d(matrix) · inverse
            return chains.pull(by_own, -_t(some) @ by_some @ _t(held))

        return full.reshape(*full.shape[:2], -1) @ self._basis, pull

    def _length(self, chains: Chains, held: FloatArray, bar: Bar) -> tuple[FloatArray, Pull]:
        """How the sliders' unknowns change the bar's length, then its own ends and length."""
        shares = np.einsum("px,pxk->pk", bar.by_posture, held)
        moving = (-shares[..., None] * chains.own).reshape(len(held), -1)
        full = np.concatenate([moving, bar.by_ends, -np.ones((len(held), 1))], axis=-1)

        def pull(weights: FloatArray) -> FloatArray:
            blocks, ends = (part[:, 0] for part in self._blocks(weights))
            by_shares = -(blocks * chains.own).sum(axis=-1)
            by_bar = np.einsum("pxk,pk->px", held, by_shares)
            by_slopes = -shares[..., None] * by_bar[:, None]
            moved = chains.pull(-shares[..., None] * blocks, by_slopes)
            return moved + bar.pull(by_bar, ends[:, : len(END_NAMES)])

        return full[:, None] @ self._basis, pull

    def _blocks(self, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Weights by chains ``(p, r, 6, 9)`` and by what a constraint link adds."""
        whole = weights @ self._basis.T
        return whole[..., :ALL].reshape(*weights.shape[:2], CHAINS, -1), whole[..., ALL:]


def _t(matrices: FloatArray) -> FloatArray:
    return np.swapaxes(matrices, 1, 2)
