"""Hooks of mkdocs: pages whose text is kept elsewhere, formulas as MathML, words of the search.

README.md is the first page; CONTRIBUTING.md, CHANGELOG.md and the notebook of the papers are pages
too. Formulas stand in the Markdown between dollar signs, as hosts of repositories show them;
browsers show MathML without a script, on paper too.
"""

from __future__ import annotations

import re
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from studies import notebook

ROOT = Path(__file__).parents[1]

PAGES = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
}
"""Files beside `docs`, and the pages that they become."""

FORMULA = re.compile(
    r"```.*?```|`[^`\n]*`|\$\$(?P<shown>.+?)\$\$|\$(?P<inline>[^$\n]+)\$", re.DOTALL
)
"""Code, which has no formulas, or a formula."""

FETCHED = re.compile(r'<(?:script|img|link|iframe)\b[^>]+(?:src|href)="(?:https?:)?//[^"]+"')
"""What a browser would fetch from the network."""

PLACE = "FORMULA{}X"
"""Stands for a formula while Markdown, which would read its underscores, becomes HTML."""


def page_of(name: str) -> str:
    """The text of a file beside `docs`, its links as from within."""
    text = (ROOT / name).read_text(encoding="utf-8")
    text = text.replace("](docs/decisions/)", "](decisions/0001-rooms.md)").replace("](docs/", "](")
    for source, page in PAGES.items():
        text = text.replace(f"]({source})", f"]({page})")
    return text


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """The pages whose text is kept elsewhere."""
    for name, page in PAGES.items():
        files.append(File.generated(config, page, content=page_of(name)))
    files.append(File.generated(config, "papers.md", content=notebook.page(notebook.read())))
    return files


def without_formulas(markdown: str) -> tuple[str, list[str]]:
    """Markdown with a place for each formula, and the formulas as MathML."""
    formulas: list[str] = []

    def place(match: re.Match[str]) -> str:
        display, inline = match["shown"], match["inline"]
        if not (display or inline):
            return match[0]
        formulas.append(convert(display or inline, display="block" if display else "inline"))
        return PLACE.format(len(formulas) - 1)

    return FORMULA.sub(place, markdown), formulas


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """The page with places for its formulas."""
    markdown, page.meta["formulas"] = without_formulas(markdown)
    return markdown


def on_page_content(html: str, page: Page, **_: object) -> str:
    """The page with its formulas."""
    for number, formula in enumerate(page.meta["formulas"]):
        html = html.replace(PLACE.format(number), formula)
    return html


def on_post_page(output: str, page: Page, **_: object) -> str:
    """The page as it is, if laboratories without a network see all of it. Raises PluginError."""
    if match := FETCHED.search(output):
        raise PluginError(f"{page.file.src_uri}: {match[0]} needs a network; keep it in docs/")
    return output


def on_post_build(config: MkDocsConfig) -> None:
    """The words of the search as a script, too: a site in a folder has no other way to them."""
    search = Path(config.site_dir) / "search"
    words = (search / "search_index.json").read_text(encoding="utf-8")
    (search / "search_index.js").write_text(f"window.searchIndex = {words};\n", encoding="utf-8")
