"""What every document shares: how its keys are read off frozen results."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, Self, TypeVar, TypeVarTuple, cast

from pydantic import BaseModel, ConfigDict, Field

from calib.arrays import FloatArray
from protocols.documents import Document

if TYPE_CHECKING:
    from pydantic.config import JsonDict

S = TypeVar("S")
R = TypeVarTuple("R")
V = TypeVar("V")
D = TypeVar("D", bound="Report")


LEFT_OUT: dict[str, Any] = {"default": None, "exclude_if": lambda value: value is None}
"""Of a key that is not there while it is None."""


@dataclass(frozen=True)
class ReadOff:
    """How the value of a field is read off the result."""

    read: Callable[..., object]

    def __call__(self, schema: JsonDict) -> None:
        """Nothing of it is in the schema."""


@dataclass(frozen=True)
class Source(Generic[*R]):
    """What a document, or a part of one, is read off: its class begins with ``of = Source[…]()``.

    A field is ``key: type = of(lambda result: result.value)``; a docstring below it goes into the
    schema. ``Part.of(result)`` is the part; one of several results is read off all of them, in
    their order. A type checker sees all of it.
    """

    def __call__(self, getter: Callable[[*R], V], *, asked: bool = False) -> V:
        """A field and how its value is read; one that is ``asked`` for is no key while None."""
        more = LEFT_OUT if asked else {}
        return cast("V", Field(json_schema_extra=ReadOff(getter), **more))

    def __get__(self, part: object, kind: type[D]) -> Callable[[*R], D]:
        return kind.read_off


class Report(Document):
    """A document, or a part of one: its fields are the keys, in their order.

    A type checker looks at what is read, so nothing is validated again; `to_json` refuses a value
    that is not finite.
    """

    model_config = ConfigDict(
        ignored_types=(Source,),
        json_schema_serialization_defaults_required=True,
        defer_build=True,  # parts are built with their document, and only for --json
    )

    @classmethod
    def read_off(cls, *results: object) -> Self:
        """What its ``of`` calls: each field reads its value off the results."""
        values: dict[str, Any] = {
            name: field.json_schema_extra.read(*results)
            for name, field in cls.model_fields.items()
            if isinstance(field.json_schema_extra, ReadOff)
        }
        return cls.model_construct(**values)


def schema(name: str) -> Any:  # noqa: ANN401 (a Literal)
    """The key ``schema`` with the document's id."""
    return Field(default=name, serialization_alias="schema")


def maybe(part: Callable[[S], V], result: S | None) -> V | None:
    """The part of a result; None where there is none."""
    return None if result is None else part(result)


def by_name(names: Iterable[str], values: FloatArray) -> dict[str, float]:
    """Values ``(n,)`` by their names."""
    return dict(zip(names, values.tolist(), strict=True))


def finite(value: float) -> float | None:
    """The value; None where it is not finite."""
    return value if math.isfinite(value) else None


def holes(rows: FloatArray) -> list[list[float | None]]:
    """A matrix with nothing in some places."""
    return [[finite(value) for value in row] for row in rows.tolist()]


@dataclass(frozen=True)
class LackOfFitEntry:
    """Variance ratio and its p-value; null where it cannot be tested."""

    statistic: float | None = None
    p_value: float | None = None


Numbers = list[float]
Matrix = list[list[float]]
Holes = list[list[float | None]]
"""A matrix with nothing in some places."""


def to_json(document: BaseModel) -> str:
    """One JSON document; a value that is not finite is a defect and raises ValueError."""
    plain = document.model_dump(mode="json")
    return json.dumps(plain, indent=1, allow_nan=False, ensure_ascii=False)
