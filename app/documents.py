"""JSON documents that other programs read: docs/schemas describes them."""

from __future__ import annotations

import json

from pydantic import BaseModel


def to_json(document: BaseModel) -> str:
    """One JSON document; a value that is not finite is a defect and raises ValueError."""
    plain = document.model_dump(mode="json")
    return json.dumps(plain, indent=1, allow_nan=False, ensure_ascii=False)
