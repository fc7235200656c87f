"""One authority and two nodes, for rossec and for TLS alike: P-256 throughout, checked in full."""

import secrets
import ssl
import time
from pathlib import Path

from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec

from ca.authority import Authority, create_root
from ca.certificates import TrustAnchor, from_pem, to_pem
from ca.keys.signing import KeySigner
from ca.svid import build_request
from rossec.channel.edhoc.credentials import Credentials

_DAY = 86400


def build(folder: Path) -> None:
    """Write `root.pem`, and `server.pem` and `client.pem` with their keys."""
    now = int(time.time())
    root_key = KeySigner(ec.generate_private_key(ec.SECP256R1()))
    root = create_root(root_key, "home", now=now, serial=secrets.randbits(127) + 1)
    (folder / "root.pem").write_bytes(to_pem(root))
    authority = Authority(root_key, root)
    for name in ("server", "client"):
        key = ec.generate_private_key(ec.SECP256R1())
        request = build_request(KeySigner(key), "home", f"/robot1/{name}")
        serial = secrets.randbits(127) + 1
        certificate = authority.issue(request, now=now, serial=serial, lifetime=_DAY)
        private = key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )
        (folder / f"{name}.pem").write_bytes(private + to_pem(certificate))


def anchor(folder: Path) -> TrustAnchor:
    """The trust anchor of both."""
    return TrustAnchor.load(from_pem((folder / "root.pem").read_bytes())[0])


def credentials(folder: Path, name: str) -> Credentials:
    """The credentials of a node."""
    pem = (folder / f"{name}.pem").read_bytes()
    key = serialization.load_pem_private_key(pem, None)
    assert isinstance(key, ec.EllipticCurvePrivateKey)
    return Credentials(KeySigner(key), from_pem(pem))


def tls(folder: Path, name: str, *, server: bool) -> ssl.SSLContext:
    """TLS 1.3, both sides with certificates, no session tickets."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER if server else ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    context.check_hostname = False
    context.verify_mode = ssl.CERT_REQUIRED
    context.load_cert_chain(folder / f"{name}.pem")
    context.load_verify_locations(folder / "root.pem")
    if server:
        context.num_tickets = 0
    return context
