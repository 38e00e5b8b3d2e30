"""The laboratory's signature in a certificate: XAdES, enveloped. Needs the extra ``sign``."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key, pkcs12
from lxml import etree
from signxml.algorithms import DigestAlgorithm, SignatureMethod
from signxml.xades.xades import XAdESSigner

from calib.errors import RecordError
from protocols.documents import read_bytes

MOST_KEY_BYTES = 100_000

ALLOWED = (
    "a PEM file with private key and certificate, or a PKCS#12 file (.p12), of a key for RSA or "
    "elliptic curves"
)


@dataclass(frozen=True)
class SigningKey:
    """A private key with its certificate, and those above it in their order."""

    key: rsa.RSAPrivateKey | ec.EllipticCurvePrivateKey
    certificates: Sequence[x509.Certificate]

    @property
    def method(self) -> SignatureMethod:
        """The algorithm for keys of this kind."""
        of_rsa = isinstance(self.key, rsa.RSAPrivateKey)
        return SignatureMethod.RSA_SHA256 if of_rsa else SignatureMethod.ECDSA_SHA256


def read_key(path: Path, password: Callable[[], str]) -> SigningKey:
    """The key in a file; ``password`` is asked where the file has one.

    Raises RecordError for a file that has no key and certificate that belong together, for a wrong
    password, and for a certificate that is not valid today.
    """
    content, thing = read_bytes(path, "key file", MOST_KEY_BYTES), f"key file {path}"
    load = _of_pem if b"-----BEGIN" in content else _of_pkcs12
    try:
        try:
            key, certificates = load(content, None)
        except (TypeError, ValueError) as problem:
            if not any(word in str(problem) for word in ("password", "encrypted")):
                raise
            key, certificates = load(content, password().encode())
    except (TypeError, ValueError) as problem:
        reason = "no key that can be read, or another password"
        raise RecordError(thing, reason=reason, allowed=ALLOWED) from problem
    if not isinstance(key, rsa.RSAPrivateKey | ec.EllipticCurvePrivateKey):
        raise RecordError(thing, reason="no private key for signatures", allowed=ALLOWED)
    certificate = next((c for c in certificates if c.public_key() == key.public_key()), None)
    if certificate is None:
        raise RecordError(thing, reason="no certificate of this key", allowed=ALLOWED)
    first, until = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    if not first <= datetime.now(UTC) <= until:
        reason = f"a certificate from {first:%Y-%m-%d} to {until:%Y-%m-%d}"
        raise RecordError(thing, reason, "one that is valid today")
    return SigningKey(key, [certificate, *(c for c in certificates if c is not certificate)])


def signed(xml: str, key: SigningKey) -> bytes:
    """The certificate with the signature as its last element."""
    signer = XAdESSigner(signature_algorithm=key.method, digest_algorithm=DigestAlgorithm.SHA256)
    root = signer.sign(
        etree.fromstring(xml.encode()),
        key=key.key,
        cert=[_base64(certificate) for certificate in key.certificates],
        always_add_key_value=False,
    )
    document: bytes = etree.tostring(root, xml_declaration=True, encoding="UTF-8")
    return document


def _base64(certificate: x509.Certificate) -> str:
    """The certificate as base64 without a last line break, which a copy as PEM could not hold."""
    return b64encode(certificate.public_bytes(Encoding.DER)).decode()


Loaded = tuple[object, list[x509.Certificate]]


def _of_pem(content: bytes, password: bytes | None) -> Loaded:
    return load_pem_private_key(content, password), x509.load_pem_x509_certificates(content)


def _of_pkcs12(content: bytes, password: bytes | None) -> Loaded:
    key, certificate, above = pkcs12.load_key_and_certificates(content, password)
    return key, [*filter(None, (certificate, *above))]
