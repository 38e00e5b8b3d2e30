"""``glidecal``, the program: refuses to start where its folders belong to another package."""

from __future__ import annotations

import gc
import sys

from glidecal import conflict

NEW_OBJECTS = 50_000
"""So many between two looks for garbage: a start makes more that stay, and looks took 5 % of it."""


def main() -> None:
    """Run it; status 2 and one sentence where it cannot be run (docs/commands.md)."""
    if conflict_words := conflict():
        print(f"glidecal: {conflict_words}", file=sys.stderr)
        sys.exit(2)
    gc.set_threshold(NEW_OBJECTS)
    from app.cli import main as run

    run()


if __name__ == "__main__":
    main()
