"""Photograph two reports as Chromium shows them: python -m studies.reports."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

from PIL import Image

from app.report.pages.report import source_of_legs, write_report

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "docs" / "pictures"
WIDTH, HEIGHT = 760, 2900
"""Up to the evidence of the diagnosis; below stand the readings."""


def demonstration(folder: Path) -> tuple[Path, Path]:
    """Sessions of a demonstration, before and after its offsets were entered."""
    command = [sys.executable, "-m", "glidecal", "demo", "--headless"]
    subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)
    before, after = sorted((folder / "demo-sessions").glob("*.jsonl"))
    return before, after


def photograph(page: Path, name: str) -> None:
    """The upper part of a page as an image."""
    chromium = shutil.which("chromium")
    if chromium is None:
        raise SystemExit("no chromium here; on Debian: apt-get install chromium")
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
    target = f"--screenshot={PICTURES / name}.png"
    size = f"--window-size={WIDTH},{HEIGHT}"
    subprocess.run([chromium, *options, size, target, page.as_uri()], check=True)
    with Image.open(PICTURES / f"{name}.png") as picture:
        picture.convert("RGB").quantize(64).save(PICTURES / f"{name}.png", optimize=True)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        before, after = demonstration(folder)
        source = partial(source_of_legs, [before], later_path=after, tolerance_mm=0.25)
        page = write_report(source, folder / "demo.html")
        photograph(page, "report_demo")
        published = ROOT / "sample_sessions" / "experiment_2_twelve.jsonl"
        source = partial(source_of_legs, [published], tolerance_mm=0.5)
        page = write_report(source, folder / "experiment.html")
        photograph(page, "report_experiment_2")
