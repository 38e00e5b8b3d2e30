"""What F1 shows: a text for each screen and for each field of a form, from ``help.toml``."""

from __future__ import annotations

import re
import tomllib
from functools import cache
from importlib import resources
from typing import Any


@cache
def _texts() -> dict[str, Any]:
    return tomllib.loads(
        resources.files("app.report.text").joinpath("help.toml").read_text(encoding="utf-8")
    )


def help_of(screen: str) -> str:
    """The help of a screen; keys in it are ids of bindings in braces."""
    texts = _texts()
    return re.sub(r"\{(pages|sizes)\}", lambda shared: texts[shared[1]], texts[screen])


def help_of_field(name: str) -> str:
    """The help of a field of the form before a session; empty where it needs none."""
    text: str = _texts()["fields"].get(name, "")
    return text
