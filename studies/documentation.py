"""Hooks of mkdocs: pages whose text is kept elsewhere, formulas as MathML, words of the search.

README.md is the first page; CONTRIBUTING.md, CHANGELOG.md and the notebook of the papers are pages
too. Formulas are in the Markdown between dollar signs, as hosts of repositories show them;
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

BAR = re.compile(r"`[^`\n]*`")
"""Code within a line; in a table its bars have backslashes, which hosts of repositories remove."""

HOME = re.compile(r'href="(\.\.?)(?:/\.)?"')
"""The theme's way to the first page: a folder, which only a server opens as a page."""

PLACE = "FORMULA{}X"
"""In the place of a formula while Markdown, which would read its underscores, becomes HTML."""


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


def as_typed(markdown: str) -> str:
    """Markdown with the bars of its code as a reader types them."""
    return BAR.sub(lambda code: code[0].replace(r"\|", "|"), markdown)


def with_way_home(html: str) -> str:
    """A page whose links to the first page name its file."""
    return HOME.sub(r'href="\1/index.html"', html)


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """The page with places for its formulas, and code as it is typed."""
    markdown, page.meta["formulas"] = without_formulas(as_typed(markdown))
    return markdown


def on_page_content(html: str, page: Page, **_: object) -> str:
    """The page with its formulas."""
    for number, formula in enumerate(page.meta["formulas"]):
        html = html.replace(PLACE.format(number), formula)
    return html


def on_post_page(output: str, page: Page, **_: object) -> str:
    """The page, its way home a file. Raises PluginError where a part would need a network."""
    if match := FETCHED.search(output):
        raise PluginError(f"{page.file.src_uri}: {match[0]} needs a network; keep it in docs/")
    return with_way_home(output)


def on_post_template(output_content: str, **_: object) -> str:
    """The page of the search, its way home a file, too."""
    return with_way_home(output_content)


def on_post_build(config: MkDocsConfig) -> None:
    """The words of the search as a script, too: a site in a folder has no other way to them."""
    search = Path(config.site_dir) / "search"
    words = (search / "search_index.json").read_text(encoding="utf-8")
    (search / "search_index.js").write_text(f"window.searchIndex = {words};\n", encoding="utf-8")
