"""What every document shares: how its keys are read off frozen results."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable
from types import SimpleNamespace
from typing import Annotated, Any, Self, TypeVar

from pydantic import AliasPath, BaseModel, BeforeValidator, ConfigDict, Field

from calib.arrays import FloatArray
from protocols.documents import Document

R = TypeVar("R")


class Report(Document):
    """A document, or a part of one: its fields are the keys, in their order.

    A value that is not finite is a defect and raises ValueError.
    """

    model_config = ConfigDict(
        from_attributes=True,
        json_schema_serialization_defaults_required=True,
        defer_build=True,  # parts are built with their document, and only for --json
    )

    @classmethod
    def of(cls, **results: object) -> Self:
        """The document of these results; the paths of its fields begin with their names."""
        return cls.model_validate(SimpleNamespace(**results))


def at(path: str, words: str | None = None) -> Any:  # noqa: ANN401 (a field of any type)
    """The value stands at these attributes of the results; ``words`` go into the schema."""
    return Field(validation_alias=AliasPath(*path.split(".")), description=words)


def asked(path: str, words: str | None = None) -> Any:  # noqa: ANN401 (as above)
    """As `at`; without this result there is no such key."""
    return Field(
        default=None,
        validation_alias=AliasPath(*path.split(".")),
        exclude_if=lambda value: value is None,
        description=words,
    )


def schema(name: str) -> Any:  # noqa: ANN401 (a Literal)
    """The key ``schema`` with the document's id."""
    return Field(default=name, serialization_alias="schema")


def made(make: Callable[[Any], object]) -> BeforeValidator:
    """The value is made of what stands there; None stays None."""
    return BeforeValidator(lambda value: None if value is None else make(value))


def called(name: str) -> BeforeValidator:
    """The part reads its fields off this result by a name, as the document does."""
    return made(lambda value: SimpleNamespace(**{name: value}))


def rows(kind: Callable[..., R], names: Iterable[str], *columns: FloatArray) -> dict[str, R]:
    """A row for each name out of columns ``(n,)``."""
    lists = (column.tolist() for column in columns)
    return {name: kind(*row) for name, *row in zip(names, *lists, strict=True)}


class LackOfFitEntry(Report):
    """Variance ratio and its p-value; null where it cannot be tested."""

    statistic: float | None = None
    p_value: float | None = None


Count = Annotated[int, made(len)]
Root = Annotated[float, made(math.sqrt)]
Finite = Annotated[float | None, made(lambda value: value if math.isfinite(value) else None)]
Thousandths = Annotated[float, made(lambda value: 1000.0 * float(value))]
"""Metres as mm, radians as mrad."""

Numbers = Annotated[list[float], made(lambda array: array.tolist())]
Matrix = Annotated[list[list[float]], made(lambda array: array.tolist())]
Holes = Annotated[
    list[list[float | None]],
    made(lambda rows: [[v if math.isfinite(v) else None for v in row] for row in rows.tolist()]),
]
"""A matrix with nothing in some places."""


def to_json(document: BaseModel) -> str:
    """One JSON document; a value that is not finite is a defect and raises ValueError."""
    plain = document.model_dump(mode="json")
    return json.dumps(plain, indent=1, allow_nan=False, ensure_ascii=False)
