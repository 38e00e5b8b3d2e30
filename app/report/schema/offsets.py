"""What ``export --format json`` writes."""

from __future__ import annotations

from typing import Literal

from app.evaluating.solution import LineParameter
from app.report.offsets import Offsets
from app.report.schema.document import Report, Source, maybe, schema
from app.report.schema.solution import FirmwareEntry, Offset

CONVENTION = "true position = believed position + d_rho; true length = nominal + d_L"


class OffsetsReport(Report):
    """``export --format json``: for another controller."""

    of = Source[Offsets]()
    schema_id: Literal["glidecal.offsets/1"] = schema("glidecal.offsets/1")
    source: str = of(lambda r: r.source)
    made: str = of(lambda r: r.made)
    """when measured, digests, program; empty where the source does not tell"""
    machine: str = of(lambda r: r.machine.name)
    convention: str = CONVENTION
    unit: Literal["mm"] = "mm"
    cautions: tuple[str, ...] = of(lambda r: r.cautions)
    """the lines that solve says of this result"""
    parameters: dict[str, Offset] = of(lambda r: r.parameters)
    firmware: FirmwareEntry | None = of(
        lambda r: maybe(FirmwareEntry.of, r.printer_change), asked=True
    )
    """of a printer: what is entered in place of the parameters"""
    lines: tuple[LineParameter, ...] = of(lambda r: r.lines)
    """lines of the drives, which a controller may hold or not; none where the machine file has no
    tolerances of lines
    """
