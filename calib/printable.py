"""Text of strangers in a form that no terminal obeys, and counts of things."""

from __future__ import annotations

import re

HIDDEN = re.compile(
    "[\x00-\x1f\x7f-\x9f\u00ad\u061c\u180e\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff"
    "\ufff9-\ufffb\ud800-\udfff\U000e0000-\U000e007f]"
)
"""Controls (C0, C1), marks without width, and those that turn the order of reading round."""


def printable(text: str, keep: str = "") -> str:
    r"""The text with every hidden character but those of ``keep`` shown as ``\u001b``.

    That is the notation of JSON: within a string of a JSON document the value stays the same.
    """
    return HIDDEN.sub(lambda match: match[0] if match[0] in keep else _escaped(match[0]), text)


def one_line(text: str) -> str:
    """Whatever line breaks a name or a sentence has: a file of lines must not break there."""
    return printable(" ".join(text.split()))


def counted(count: int, noun: str) -> str:
    """``1 reading``, ``2 readings``."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def with_capital(text: str) -> str:
    """The text with a capital at its beginning; ports, paths and units in it stay as they are."""
    return f"{text[:1].upper()}{text[1:]}"


def _escaped(character: str) -> str:
    units = character.encode("utf-16-be", "surrogatepass").hex()
    return "".join(f"\\u{units[k : k + 4]}" for k in range(0, len(units), 4))
