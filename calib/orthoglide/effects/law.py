"""One entry of the catalogue, and the same entry put somewhere with a size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from numpy.typing import NDArray

from calib.observations import Conditions
from calib.orthoglide.effects.kinds import EffectParameter, Kind
from calib.orthoglide.pipeline import Flow, Stage


class Law(Protocol):
    """What an effect does; a small frozen dataclass.

    Laws of one ``id`` are variants of it and differ in the names of their parameters.
    """

    @property
    def id(self) -> str:
        """Name in the catalogue, such as ``backlash``."""

    @property
    def title(self) -> str:
        """The effect in the words of a workshop."""

    @property
    def kind(self) -> Kind:
        """Where its cause lies."""

    @property
    def stage(self) -> Stage:
        """The one stage of the pipeline that it changes."""

    @property
    def parameters(self) -> tuple[EffectParameter, ...]:
        """Parameters of one place."""

    @property
    def invariances(self) -> tuple[str, ...]:
        """What it does not depend on, in words."""

    @property
    def controller(self) -> str:
        """What the controller can be given against it, in words; empty if nothing."""

    def places(self, taken: Conditions) -> tuple[str, ...]:
        """Where it may act: legs, pairs, directions of legs or mounts (``"xy"``)."""

    def change(
        self, passing: NDArray[Any], flow: Flow, place: str, values: Sequence[Any]
    ) -> NDArray[Any]:
        """What the stage hands on instead of ``passing``.

        ``values`` in the units of `parameters`. Leading axes of ``passing`` and ``flow`` hold
        several machines; values may be complex.
        """


@dataclass(frozen=True)
class Placed:
    """A law at one place with values in its units: an effect for the pipeline."""

    law: Law
    place: str
    values: tuple[float | complex, ...]

    @property
    def id(self) -> str:
        """Name in the catalogue."""
        return self.law.id

    @property
    def stage(self) -> Stage:
        """The stage of the law."""
        return self.law.stage

    def change(self, passing: NDArray[Any], flow: Flow) -> NDArray[Any]:
        """The law with these values, at this place."""
        return self.law.change(passing, flow, self.place, self.values)
