"""One ambiguous session followed up: truths beside what was said before and after."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tests.blind.scoring import places, same_place

Json = dict[str, Any]
Name = tuple[str, str]


@dataclass(frozen=True)
class Trial:
    """The sealed truth and the documents: the first session alone, then one more each time."""

    truth: Json
    documents: tuple[Json, ...]

    @property
    def first(self) -> Json:
        """What was said before anything was added."""
        return self.documents[0]

    @property
    def hidden(self) -> Json:
        """The one hidden effect."""
        effect: Json = self.truth["hidden"][0]
        return effect

    @property
    def followed(self) -> bool:
        """Whether a measurement was proposed and taken."""
        return len(self.documents) > 1

    @property
    def expected(self) -> float:
        """Noise variances by which the first proposal promised to separate."""
        return float(self.first["next_measurement"]["apart"])

    @property
    def between(self) -> set[Name]:
        """Names that the first proposal is to separate: not in all that may be true together."""
        sets: list[set[Name]] = [
            {(effect["id"], effect["where"]) for effect in together}
            for together in self.first["next_measurement"]["names"]
        ]
        common = sets[0].intersection(*sets[1:])
        return set().union(*sets) - common

    def after(self, rounds: int) -> Json:
        """What was said after so many measurements; the last word where there were fewer."""
        return self.documents[min(rounds, len(self.documents) - 1)]

    def resolved(self) -> bool:
        """After one: of the names to separate at most one is left, and the truth is not lost."""
        names_left = possible(self.after(1))
        return len(self.between & names_left) <= 1 and self.hidden["id"] in {
            name for name, _ in names_left
        }

    def single(self, rounds: int) -> bool:
        """One name, the right one, at the right place, without a rival."""
        document = self.after(rounds)
        if document["verdict"] != "explained" or len(document["effects"]) != 1:
            return False
        (effect,) = document["effects"]
        right = effect["id"] == self.hidden["id"] and same_place(
            effect["where"], places(self.hidden)
        )
        return right and not effect["indistinguishable_from"]

    def wrong(self) -> bool:
        """After one: explained by names among which the truth is not."""
        document = self.after(1)
        names = {name for name, _ in possible(document)}
        return document["verdict"] == "explained" and self.hidden["id"] not in names


def possible(document: Json) -> set[Name]:
    """Every name and place that a document leaves open."""
    ids = {(effect["id"], effect["where"]) for effect in document["effects"]}
    rivals = {
        (rival["id"], rival["where"])
        for effect in document["effects"]
        for rival in effect["indistinguishable_from"]
    }
    return ids | rivals
