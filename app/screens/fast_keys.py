"""Actions and screens that bear keys coming faster than Textual handles them (8.2.8).

A pasted text, a bouncing foot switch and a cat on the keyboard are such keys. Taken out for a
trial, each part failed `tests/screens/test_fast_keys.py` with GLIDECAL_FUZZ=2000, so many random
keys a seed; only the look at a list in `ready` was not missed.
"""

from __future__ import annotations

from textual._context import active_message_pump  # no public name tells whose message it is
from textual.await_complete import AwaitComplete
from textual.css.query import NoMatches
from textual.dom import DOMNode
from textual.screen import Screen, ScreenResultType
from textual.widget import Widget
from textual.widgets import OptionList
from textual.worker import WorkerFailed


def ready(node: DOMNode | None) -> bool:
    """Whether a key may act on this part: its screen is whole and on top.

    Textual acts on a screen that is gone or half made, whose parts are missing, and turns the pages
    of a list that was not laid out: NoMatches, KeyError.
    """
    if not isinstance(node, Widget):
        return True
    if isinstance(node, OptionList) and not node.scrollable_content_region:
        return False
    return node.is_attached and node.screen.is_active and node.screen.is_mounted


def lacks_parts(error: Exception) -> bool:
    """Whether a part that is being removed, alone or with its screen, missed what it looks for.

    What is left while it comes gets no parts, or parts of parts, and all the same the messages on
    which it looks for them: its own mount, or, in a list of Textual's (issue 6581), the choice.
    """
    cause = error.error if isinstance(error, WorkerFailed) else error
    node = active_message_pump.get(None)
    if not (isinstance(cause, NoMatches) and isinstance(node, Widget)):
        return False
    if not (node.app.is_running and node.is_attached):
        return True
    return any(
        node_above._pruning or node_above._closing for node_above in node.ancestors_with_self
    )


class LeftOnce(Screen[ScreenResultType]):
    """A screen with a result that goes once: Textual pops whatever is on top instead."""

    def dismiss(self, result: ScreenResultType | None = None) -> AwaitComplete:
        return super().dismiss(result) if self.is_active else AwaitComplete()
