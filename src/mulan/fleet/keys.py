"""Certificates by which a base station and its robots know each other (X.509, ECDSA P-256)."""

import ipaddress
import os
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from mulan.errors import InputError
from mulan.fleet.names import BASE, check_robot_name

Pair = tuple[ec.EllipticCurvePrivateKey, x509.Certificate]


def make_keys(folder: Path, robots: Sequence[str], hosts: Sequence[str], days: int) -> None:
    """Make an authority, and a certificate for the base station and for each robot, named after it.

    An authority that is already in the folder is kept, so that robots can be added; existing certificates are
    not replaced.

    Args:
        folder: Where ``authority.pem``, ``NAME.pem`` and ``NAME.key`` are written; keys are readable by their
            owner alone.
        robots: Names.
        hosts: Names or addresses under which robots reach the base station.
        days: How long the certificates are valid.

    Raises:
        InputError: A name is not valid, or a file cannot be read or written.
    """
    for robot in robots:
        check_robot_name(robot, "mulan fleet keys")
    if not hosts:
        remedy = "give the names or addresses robots reach it by"
        raise InputError("mulan fleet keys", "hosts", "are not given for the base station", remedy)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        authority = _authority(folder, days)
        for name in (BASE, *robots):
            if (folder / f"{name}.pem").exists():
                continue
            alternatives = hosts if name == BASE else ()
            _write(folder, name, _signed(authority, name, alternatives, days))
    except OSError as error:
        raise InputError(folder, "writing", error.strerror or str(error), "choose another --out") from error


def _authority(folder: Path, days: int) -> Pair:
    certificate, key = folder / "authority.pem", folder / "authority.key"
    if not (certificate.exists() and key.exists()):
        pair = _signed(None, "MULAN fleet authority", (), days)
        _write(folder, "authority", pair)
        return pair
    try:
        loaded = serialization.load_pem_private_key(key.read_bytes(), None)
        if not isinstance(loaded, ec.EllipticCurvePrivateKey):
            raise ValueError("it is of another kind")
        return loaded, x509.load_pem_x509_certificate(certificate.read_bytes())
    except (ValueError, TypeError) as error:
        remedy = "choose an empty folder"
        raise InputError(key, "key", f"cannot be used ({error})", remedy) from error


def _signed(authority: Pair | None, name: str, hosts: Sequence[str], days: int) -> Pair:
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    issuer = subject if authority is None else authority[1].subject
    now = datetime.now(UTC)
    usage = (
        dict.fromkeys(("key_cert_sign", "crl_sign"), True)
        if authority is None
        else {"digital_signature": True}
    )
    flags = dict.fromkeys(
        (
            "digital_signature",
            "content_commitment",
            "key_encipherment",
            "data_encipherment",
            "key_agreement",
            "key_cert_sign",
            "crl_sign",
            "encipher_only",
            "decipher_only",
        ),
        False,
    )
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(hours=1))  # a robot's clock may be behind
        .not_valid_after(now + timedelta(days=days))
        .add_extension(x509.BasicConstraints(ca=authority is None, path_length=None), critical=True)
        .add_extension(x509.KeyUsage(**(flags | usage)), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )
    if authority is not None:
        purposes = [ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH]
        identifier = x509.AuthorityKeyIdentifier.from_issuer_public_key(authority[0].public_key())
        builder = builder.add_extension(x509.ExtendedKeyUsage(purposes), critical=False).add_extension(
            identifier, critical=False
        )
        if hosts:
            names = x509.SubjectAlternativeName([_alternative(host) for host in hosts])
            builder = builder.add_extension(names, critical=False)
    signer = key if authority is None else authority[0]
    return key, builder.sign(signer, hashes.SHA256())


def _alternative(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _write(folder: Path, name: str, pair: Pair) -> None:
    key, certificate = pair
    secret = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    handle = os.open(folder / f"{name}.key", os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    with os.fdopen(handle, "wb") as file:
        file.write(secret)
    (folder / f"{name}.pem").write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
