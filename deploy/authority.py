"""A small certificate authority: one certificate per process, for mutual TLS. Needs the extra ``sim``."""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence
from datetime import datetime, timedelta

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from wire.credentials import Certificate

LIFE = timedelta(days=3650)
"""Of the authority itself."""
CLOCK_SKEW = timedelta(minutes=5)
"""Clocks of several machines differ: a certificate is valid from a little before it was made."""
HERE = ("localhost", "127.0.0.1", "::1")


def new_authority(now: datetime) -> tuple[str, str]:
    """Certificate and key, both PEM, of a new authority. The key signs certificates and nothing else."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = _name("Palanquin credentials")
    certificate = (
        _builder(name, name, key.public_key(), now, now + LIFE)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_key_usage(signs_certificates=True), critical=True)
        .sign(key, hashes.SHA256())
    )
    return _pem(certificate), _key_pem(key)


def issue(
    authority: str, authority_key: str, login: str, now: datetime, expires: datetime, server_names: Sequence[str] = ()
) -> Certificate:
    """A new key and the certificate for it, in which the common name is the login.

    Args:
        authority, authority_key: PEM texts.
        server_names: host names and addresses under which it listens; without any it can only be a client's, so that
            no agent's certificate passes for the simulator's.
    """
    signer = serialization.load_pem_private_key(authority_key.encode(), None)
    if not isinstance(signer, ec.EllipticCurvePrivateKey):
        raise TypeError("the authority's key is not one of ours")
    issuer = x509.load_pem_x509_certificate(authority.encode())
    key = ec.generate_private_key(ec.SECP256R1())
    uses = [ExtendedKeyUsageOID.CLIENT_AUTH] + ([ExtendedKeyUsageOID.SERVER_AUTH] if server_names else [])
    builder = (
        _builder(_name(login), issuer.subject, key.public_key(), now, min(expires, issuer.not_valid_after_utc))
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_key_usage(signs_certificates=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage(uses), critical=False)
        .add_extension(x509.SubjectAlternativeName([_general(n) for n in server_names or (login,)]), critical=False)
    )
    return Certificate(authority, _pem(builder.sign(signer, hashes.SHA256())), _key_pem(key))


def fingerprint(certificate: str) -> str:
    """SHA-256 of a PEM certificate, as ``openssl x509 -fingerprint -sha256`` prints it."""
    return x509.load_pem_x509_certificate(certificate.encode()).fingerprint(hashes.SHA256()).hex(":").upper()


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, now: datetime, expires: datetime
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - CLOCK_SKEW)
        .not_valid_after(expires)
    )


def _name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _general(name: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(name))
    except ValueError:
        return x509.DNSName(name)


def _key_usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _pem(certificate: x509.Certificate) -> str:
    return certificate.public_bytes(serialization.Encoding.PEM).decode()


def _key_pem(key: ec.EllipticCurvePrivateKey) -> str:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    ).decode()
