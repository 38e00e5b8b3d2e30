"""``glidecal``, the program: refuses to start where its folders belong to another package."""

from __future__ import annotations

import sys

from glidecal import conflict


def main() -> None:
    """Run it; status 2 and one sentence where it cannot be run (docs/commands.md)."""
    if conflict_words := conflict():
        print(f"glidecal: {conflict_words}", file=sys.stderr)
        sys.exit(2)
    from app.cli import main as run

    run()


if __name__ == "__main__":
    main()
