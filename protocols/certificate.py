"""Who issues a calibration certificate, for whom, and under which number."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from calib.printable import printable
from protocols.documents import MOST_LETTERS, Day, Document, read_toml


def _single_line(text: str) -> str:
    line = printable(" ".join(text.split()))
    if not line:
        raise ValueError("a text, not nothing")
    return line


Entry = Annotated[str, Field(max_length=MOST_LETTERS), AfterValidator(_single_line)]
"""A line of an address or a name: never empty, no space at its ends."""

Number = Annotated[str, Field(max_length=40), AfterValidator(_single_line)]
Country = Annotated[str, Field(pattern="^[A-Z]{2}$")]
"""As ISO 3166-1 writes it: DE, FR."""


MOST_INSTRUMENTS = 100


class Organisation(Document):
    """A laboratory or a customer with its address."""

    name: Entry
    street: Entry | None = None
    post_code: Entry | None = None
    city: Entry | None = None
    country: Country | None = None
    email: Entry | None = None
    phone: Entry | None = None

    @property
    def address(self) -> tuple[str, ...]:
        """The lines below the name."""
        city = " ".join(filter(None, [self.post_code, self.city]))
        return tuple(filter(None, [self.street, ", ".join(filter(None, [city, self.country]))]))


class Laboratory(Organisation):
    """The head of a certificate.

    ``accreditation`` is the number that the accreditation body gave; ``logo`` is a PNG or JPEG
    file, from the folder of the settings file.
    """

    accreditation: Entry | None = None
    logo: str | None = None


class MachineIdentity(Document):
    """What tells the machine from others of its kind."""

    manufacturer: Entry | None = None
    model: Entry | None = None
    serial_number: Entry | None = None


class InstrumentIdentity(Document):
    """A measuring instrument, and the certificate that makes its readings traceable."""

    name: Entry
    serial_number: Entry | None = None
    certificate: Entry | None = None
    certificate_date: Day | None = None


class CertificateOrder(Document):
    """What a person states of one certificate.

    ``place`` says where the machine was calibrated, ``performed_at`` whose place that is;
    ``issued`` is the day of issue, ``signed_by`` who signs; ``instrument`` are instruments that no
    record names, such as a laser tracker.
    """

    schema_id: Literal["glidecal.certificate/1"] = Field(
        alias="schema", default="glidecal.certificate/1"
    )
    number: Number
    place: Entry | None = None
    performed_at: Literal["laboratory", "customer", "other"] = "other"
    issued: Day | None = None
    signed_by: Entry | None = None
    customer: Organisation
    machine: MachineIdentity = MachineIdentity()
    instrument: Annotated[tuple[InstrumentIdentity, ...], Field(max_length=MOST_INSTRUMENTS)] = ()


def read_order(path: Path) -> CertificateOrder:
    """The order of a certificate in a TOML file. Raises RecordError naming the key."""
    return read_toml(path, CertificateOrder, "certificate file")
