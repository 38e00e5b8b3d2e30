"""Run the notebook of the papers and keep what it prints: python -m studies.notebook.

Its cells are plain Python, so no kernel is needed; Jupyter opens and runs it as any other.
"""

from __future__ import annotations

import contextlib
import json
from io import StringIO
from pathlib import Path
from typing import Any

NOTEBOOK = Path(__file__).parents[1] / "docs" / "papers.ipynb"

Notebook = dict[str, Any]
"""As nbformat 4.5 has it."""


def executed(notebook: Notebook) -> Notebook:
    """The notebook with what its cells print when they run one after the other, in its folder."""
    namespace: dict[str, Any] = {"__name__": "__main__"}
    cells, count = [], 0
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            count += 1
            printed = StringIO()
            code = compile("".join(cell["source"]), f"cell {count}", "exec")
            with contextlib.chdir(NOTEBOOK.parent), contextlib.redirect_stdout(printed):
                exec(code, namespace)  # of this repository
            text = printed.getvalue().splitlines(keepends=True)
            outputs = [{"name": "stdout", "output_type": "stream", "text": text}] if text else []
            cell = cell | {"execution_count": count, "outputs": outputs}
        cells.append(cell)
    return notebook | {"cells": cells}


def read() -> Notebook:
    """The notebook as it is kept."""
    notebook: Notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    return notebook


def page(notebook: Notebook) -> str:
    """The notebook as Markdown."""
    parts = []
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for output in cell.get("outputs", ()):
            parts.append(f"```\n{''.join(output['text'])}```")
    return "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    text = json.dumps(executed(read()), indent=1, ensure_ascii=False) + "\n"
    NOTEBOOK.write_text(text, encoding="utf-8", newline="\n")
