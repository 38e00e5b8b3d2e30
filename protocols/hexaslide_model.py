"""The model of a Hexa Slide: its machine, and the effects that were adopted for it."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from protocols.documents import Document, read_json
from protocols.effect_entries import EffectEntry, HistoryEntry
from protocols.hexaslide import HexaSlideMachine


class HexaSlideModel(Document):
    """A machine with its parameters as they were fitted beside the adopted effects, and how these
    came and went. What a controller is to hold is not this machine, but the exported one.
    """

    schema_id: Literal["glidecal.hexaslide-model/1"] = Field(
        alias="schema", default="glidecal.hexaslide-model/1"
    )
    machine: HexaSlideMachine
    effects: tuple[EffectEntry, ...] = ()
    history: tuple[HistoryEntry, ...] = ()

    def text(self) -> str:
        """The file's content."""
        return self.model_dump_json(indent=1, exclude_none=True) + "\n"


def read_hexaslide_model(path: Path) -> HexaSlideModel:
    """A model file as it stands. Raises RecordError naming the file and the fault."""
    return read_json(path, HexaSlideModel, "model", "schema glidecal.hexaslide-model/1")
