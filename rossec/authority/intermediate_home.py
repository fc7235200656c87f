"""Set up an intermediate on its host: a key and a request first, then what the root signed.

Until the root has signed, the directory has no `ca.pem` and is not an authority yet.
"""

import contextlib
from pathlib import Path
from typing import Final

from ca.authority import Authority
from ca.certificates import TrustAnchor, from_pem, to_pem
from ca.intermediates import Intermediate, build_intermediate_request
from ca.keys import key_files
from ca.keys.signer import KeySigner
from ca.store.record import Store
from rossec import files
from rossec.authority.home import AuthorityHome
from rossec.errors import ConfigurationError

REQUEST: Final = "intermediate.csr"
OWNED: Final = (files.Owned(r"intermediate\.csr"), files.Owned(r"intermediate\.pem", public=True))


def begin(home: Path, domain: str, passphrase: str) -> Path:
    """Create the key of an intermediate and its request for the root; returns its path.

    Raises:
        ConfigurationError: there is an authority here already.
        KeyRefused: there is a key already.
    """
    path = home / "ca"
    if (path / "ca.pem").exists():
        raise ConfigurationError(
            f"there is an authority in {path}, whose service renews identities: rossec ca serve",
            "for an intermediate on another host, there: ROSSEC_HOME=~/intermediate rossec ca"
            f" intermediate request {domain}",
        )
    files.make_private_directory(path)
    key = key_files.generate()
    request = build_intermediate_request(KeySigner(key), domain)
    key_files.write_private(path / "ca.key", key, passphrase)
    files.create(path / REQUEST, request, 0o644)
    return path / REQUEST


def install(home: Path, bundle: bytes, passphrase: str, now: int) -> Intermediate:
    """Install what the root signed; a newer certificate for the same key replaces the older.

    Raises:
        CertificateRefused: not an intermediate, or not valid now.
        IssueRefused: for another key than the one here.
        ConfigurationError: below another root than before.
    """
    path = home / "ca"
    der, root = _split(bundle)
    anchor = TrustAnchor.load(root)
    found = anchor.check_intermediate(der, now)
    signer = KeySigner(key_files.load_private(path / "ca.key", passphrase))
    Authority(signer, root, der)
    if (path / "ca.pem").exists() and AuthorityHome(path).anchor().thumbprint != anchor.thumbprint:
        raise ConfigurationError(
            "this is the intermediate of another root", "start again in another ROSSEC_HOME"
        )
    if not (path / "ca.db").exists():
        Store.create(path / "ca.db").close()
    files.replace(path / "intermediate.pem", to_pem(der), 0o644)
    files.replace(path / "ca.pem", to_pem(root), 0o644)
    with contextlib.closing(Store.open(path / "ca.db")) as store:
        store.log_event("installed", "intermediate", found.thumbprint.hex(), now)
    return found


def _split(bundle: bytes) -> tuple[bytes, bytes]:
    match from_pem(bundle):
        case (der, root):
            return der, root
        case found:
            raise ConfigurationError(
                f"a bundle of {len(found)} certificates where two are expected",
                "take the file `rossec ca intermediate sign` wrote",
            )
