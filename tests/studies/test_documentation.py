"""The site of the documentation: every page is in its navigation, and every formula is typeset."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from studies.documentation import PAGES, as_typed, page_of, with_way_home, without_formulas

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


def test_every_page_is_in_the_navigation_once() -> None:
    named = re.findall(
        r": (\S+\.md)$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), re.MULTILINE
    )
    pages = [path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")]
    assert sorted(named) == sorted([*pages, *PAGES.values(), "papers.md"])


def test_every_formula_of_the_theory_is_typeset() -> None:
    text, formulas = without_formulas((DOCS / "theory.md").read_text(encoding="utf-8"))
    assert len(formulas) > 100
    assert "$" not in text
    for formula in formulas:
        assert formula.startswith("<math")
        assert "\\" not in formula, "a command that the converter does not know"


def test_code_has_no_formulas() -> None:
    text = "`$3` and `$100`\n\n```\necho $HOME $PATH\n```\n"
    assert without_formulas(text) == (text, [])


def test_bars_of_code_in_a_table_are_those_that_a_reader_types() -> None:
    """Before: the site showed their backslashes."""
    assert as_typed(r"| `run --frame a\|b` | a \| b |") == r"| `run --frame a|b` | a \| b |"


def test_the_way_home_is_a_file() -> None:
    """Before: a browser that opened the site from a folder listed that folder."""
    assert with_way_home('<a href=".">') == '<a href="./index.html">'
    assert with_way_home('<a href="./.">') == '<a href="./index.html">'
    assert with_way_home('<a href="..">') == '<a href="../index.html">'
    assert with_way_home('<a href="./x.html">') == '<a href="./x.html">'


@pytest.mark.parametrize("name", PAGES)
def test_links_of_a_page_kept_elsewhere_are_those_of_the_site(name: str) -> None:
    targets = re.findall(r"\]\(([^)#]+)[^)]*\)", page_of(name))
    for target in targets:
        if not target.startswith("http"):
            assert (DOCS / target).exists() or target in PAGES.values(), target
