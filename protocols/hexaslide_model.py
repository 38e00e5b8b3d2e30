"""The model of a Hexa Slide: its machine, and the effects that were adopted for it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

from pydantic import Field

from protocols.documents import Document, read_json
from protocols.effect_entries import EffectEntry, HistoryEntry
from protocols.hexaslide import HexaSlideMachine

Schema = Literal["glidecal.hexaslide-model/2"]
NEWEST: Schema = "glidecal.hexaslide-model/2"
OLDER = NEWEST.replace("/2", "/1")
PLAYS = ("backlash", "leg_backlash")


class HexaSlideModel(Document):
    """A machine with its parameters as they were fitted beside the adopted effects, and how these
    came and went. What a controller is to hold is not this machine, but the exported one.
    """

    schema_id: Schema = Field(alias="schema", default=NEWEST)
    machine: HexaSlideMachine
    effects: tuple[EffectEntry, ...] = ()
    history: tuple[HistoryEntry, ...] = ()

    def text(self) -> str:
        """The file's content."""
        return self.model_dump_json(indent=1, exclude_none=True) + "\n"


def read_hexaslide_model(path: Path) -> HexaSlideModel:
    """A model file in the newest form. Raises RecordError naming the file and the fault."""
    return read_json(path, HexaSlideModel, "model", f"schema {NEWEST}", renewed=_renewed)


def _renewed(text: str) -> str:
    """Form 1 had play negative where a carriage stays behind; what is no such file stays."""
    try:
        content = json.loads(text)
        if content["schema"] != OLDER:
            return text
        changes = [line["effect"] for line in content.get("history", ())]
        for effect in (*content.get("effects", ()), *changes):
            if effect["id"] in PLAYS:
                for parameter in effect["parameters"].values():
                    parameter["value"] = -parameter["value"]
    except (AttributeError, KeyError, TypeError, ValueError):
        return text
    return json.dumps(content | {"schema": NEWEST})
