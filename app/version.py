"""Name and version of the program."""

VERSION = "0.1.0"


def program() -> str:
    """Name and version for records."""
    return f"glidecal {VERSION}"
