"""Certificates of sessions, and what a laboratory states for them, in files of a folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from PIL import Image

from app.report.certificate import CertificateHead, calibration_of
from app.report.pages.contents import report_from
from app.report.pages.two_pages import CalibrationReport

LABORATORY = """\
[laboratory]
name = "Laboratory <b>& Sons</b>"
street = "Long Street 12"
post_code = "38116"
city = "Brunswick"
country = "DE"
accreditation = "D-K-00000"
logo = "logo.png"
"""

ORDER = """\
schema = "glidecal.certificate/1"
number = "2026-0042"
place = "hall 3"
performed_at = "customer"
issued = 2026-11-25
signed_by = "A. Example"

[customer]
name = "<script>alert(1)</script> & Co."
city = "Sample Town"

[machine]
manufacturer = "Maker"
model = "Model 3"
serial_number = "OG-0007"
"""


def report_of(
    paths: Sequence[Path],
    *,
    after: Path | None = None,
    tolerance_mm: float | None = None,
    head: CertificateHead | None = None,
) -> CalibrationReport:
    """The report of sessions, as `calibration_of` takes them."""
    return report_from(
        calibration_of(paths, later_path=after, tolerance_mm=tolerance_mm, head=head)
    )


def laboratory(
    folder: Path, monkeypatch: pytest.MonkeyPatch, text: str = LABORATORY, order: str = ORDER
) -> Path:
    """The order of a certificate; the settings file with its logo lies beside it."""
    (folder / "settings.toml").write_text(text, encoding="utf-8")
    monkeypatch.setenv("GLIDECAL_SETTINGS", str(folder / "settings.toml"))
    Image.new("RGB", (600, 600), (27, 108, 168)).save(folder / "logo.png")
    path = folder / "order.toml"
    path.write_text(order, encoding="utf-8")
    return path
