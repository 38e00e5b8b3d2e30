"""Name and version of the program: the release, and the commit that it was made from.

An installed program got its version when its wheel was built (setuptools-scm, from git). The
version of an editable installation would stay at the commit of its day; so in a checkout the commit
is read from git's files, when it is wanted and without running git. Such a version ends with
``checkout``: whether the files are as committed is not known.
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

HOME = Path(__file__).parent.parent

NEXT_RELEASE = "0.1.0.dev0"
"""What is told where git tells no release; ``fallback_version`` of pyproject.toml is the same."""

DIGITS = 9
COMMIT = re.compile(rf"([0-9a-f]{{{DIGITS}}})[0-9a-f]{{31,55}}")


@cache
def version() -> str:
    """Version by PEP 440, the commit behind the ``+``: ``0.1.0.dev752+g84cc33ab2``."""
    if (HOME / ".git").exists():
        commit = COMMIT.fullmatch(_head(HOME / ".git"))
        return f"{NEXT_RELEASE}+g{commit[1]}.checkout" if commit else f"{NEXT_RELEASE}+checkout"
    from importlib.metadata import distributions

    installed = distributions(name="glidecal", path=[str(HOME)])
    return next((distribution.version for distribution in installed), f"{NEXT_RELEASE}+unknown")


def program() -> str:
    """Name and version for records."""
    return f"glidecal {version()}"


def _head(git: Path) -> str:
    """The commit that is checked out; empty where these files do not tell it."""
    try:
        if git.is_file():  # a worktree beside the first one
            git = git.parent / git.read_text(encoding="utf-8").removeprefix("gitdir:").strip()
        head = (git / "HEAD").read_text(encoding="utf-8").strip()
        if not head.startswith("ref: "):
            return head
        branch = head.removeprefix("ref: ")
        shared = git / "commondir"
        common = git / shared.read_text(encoding="utf-8").strip() if shared.exists() else git
        if (common / branch).is_file():
            return (common / branch).read_text(encoding="utf-8").strip()
        packed = (common / "packed-refs").read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        return ""
    return next((line.split()[0] for line in packed if line.endswith(f" {branch}")), "")
