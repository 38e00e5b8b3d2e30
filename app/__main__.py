"""``python -m app`` is the same as ``glidecal``."""

from app.cli import main

main()
