"""The directory of an authority: its key, its certificate, its record, its own node; `signing` signs.

The URI of a key in a token names a PKCS#11 module, code that is loaded, but it is in `ca/`, which a
backup fills: whoever made that would name the code that is run to verify it. So a module is loaded
only if it is in `pkcs11-modules`, one absolute path a line, beside `ca/`, where nothing that is
restored is written. `rossec ca init --key` and `rossec ca restore --pkcs11-module` write it there.
"""

import contextlib
import secrets
import shutil
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import Final, Self

from ca.authority import LIFETIME, Authority, create_root
from ca.certificates import TrustAnchor, from_pem, to_pem
from ca.domains import DomainList, open_domains
from ca.errors import RevocationRefused, TokenRefused
from ca.keys import private_keys
from ca.keys.private_keys import KeyUri, TokenSigner
from ca.keys.signing import KeySigner, PublicKey, Signer
from ca.names import check_domain
from ca.revocation.lists import is_tree, open_tree
from ca.store.record import Store
from rossec import environment, files
from rossec.authority import signing
from rossec.authority.signing import OWN_NODE, SigningAuthority, delegations
from rossec.errors import ConfigurationError
from rossec.home import NodeHome

FILE: Final = "pkcs11-modules"  # in ROSSEC_HOME
_MAX: Final = 64 * 1024


def trusted(home: Path) -> frozenset[str]:
    """The modules that were named for ROSSEC_HOME `home`; none is named without the file."""
    if not (home / FILE).is_symlink() and not (home / FILE).exists():
        return frozenset()
    missing = ConfigurationError(f"there is no {FILE} any more", "do it again")
    data = files.read_own(home / FILE, _MAX, missing)
    try:
        lines = data.decode().splitlines()
    except UnicodeDecodeError:
        raise ConfigurationError(f"{home / FILE} is not UTF-8", "write one absolute path a line") from None
    return frozenset(line.strip() for line in lines if line.startswith("/"))


def trust(home: Path, module: str) -> None:
    check_absolute(module)
    known = trusted(home)
    if module in known:
        return
    files.make_private_directory(home)
    lines = "".join(f"{each}\n" for each in sorted({*known, module}))
    files.replace(home / FILE, lines.encode())


def check_absolute(module: str) -> None:
    if not module.startswith("/") or not module.isprintable():
        raise TokenRefused(
            f"{module!a} is not the absolute path of a PKCS#11 module",
            "a relative one is another file in each directory: write it from the root",
        )


def restored_uri(data: bytes, home: Path, named: str | None) -> KeyUri:
    uri = KeyUri.parse(data.decode(errors="replace").strip())
    if named is not None:
        check_absolute(named)
        return replace(uri, module=named)
    if uri.module not in trusted(home):
        raise TokenRefused(
            f"the key of the backup is in a token, behind the module {uri.module!a} as it says",
            "a module is code that is run: name the one to trust: --pkcs11-module /path/to.so",
        )
    return uri


NODE: Final = "node"  # the identity `/ca`
RECORD: Final = "ca.db"
ENTRIES: Final = "revocations.entries"  # of a tree, next to the statement in a master's home
AUDIT_FILE: Final = "audit.log"  # of its service
KEY_URI: Final = "ca.uri"  # names the key, if it is in a token
OWNED: Final = (
    files.Owned(r"ca\.(?:key|uri)"),
    files.Owned(r"ca\.pem", public=True),
    files.Owned(r"ca\.db"),  # as a snapshot
    files.Owned(r"ca\.db-(?:wal|shm|journal)", kept=False),
    files.Owned(r"audit\.log[^/]{0,120}", kept=False),  # of one host, and larger than a backup
)
_MAX_URI: Final = 4096
DELIVERED: Final = "delivered"  # in the log: a delegation that its master has
_SIZE_LIMIT: Final = 256 * 1024
OWN_LIFETIME: Final = 366 * 86400


class AuthorityHome:
    def __init__(self, path: Path) -> None:
        self.path = path

    @classmethod
    def at(cls, home: Path) -> Self:
        path = home / "ca"
        if not (path / "ca.pem").exists():
            raise ConfigurationError(f"there is no authority in {home}", environment.missing_authority(home))
        return cls(path)

    @staticmethod
    def check_new(home: Path) -> Path:
        path = home / "ca"
        if path.exists():
            raise ConfigurationError(
                f"there is an authority in {path}", "give another ROSSEC_HOME for a second one"
            )
        return path

    @classmethod
    def create(cls, home: Path, domain: str, passphrase: str, now: int, uri: KeyUri | None = None) -> Self:
        """Create a new authority with its own node `/ca` and an empty revocation list."""
        # Its key is in a file encrypted with `passphrase`; with `uri` it is generated in that token, and
        # `passphrase` is the PIN.
        path = cls.check_new(home)
        check_domain(domain)
        key = private_keys.generate()
        if uri is not None:
            check_absolute(uri.module)
        signer = KeySigner(key) if uri is None else TokenSigner.create(uri, passphrase)
        root = create_root(signer, domain, now=now, serial=secrets.randbits(127) + 1)
        # In a temporary directory: an interrupted creation leaves nothing at `path`.
        staging = path.with_name(f".{path.name}.{secrets.token_hex(8)}")
        try:
            files.make_private_directory(staging)
            with contextlib.closing(Store.create(staging / RECORD)) as store:
                unlocked = SigningAuthority(Authority(signer, root), store, staging)
                unlocked.sign_list(now)
                own = NodeHome(staging / NODE, OWN_NODE)
                own.create_request(domain)
                own.install(unlocked.issue(own.request(), now, OWN_LIFETIME), now)
            files.create(staging / "ca.pem", to_pem(root), 0o644)
            if uri is None:
                private_keys.write_private(staging / "ca.key", key, passphrase)
            else:
                files.create(staging / KEY_URI, f"{uri}\n".encode())
                trust(home, uri.module)
            # In one step, last: what is at `path` is whole, with its key and its first list.
            files.commit_directory(staging, path)
        except BaseException:
            shutil.rmtree(staging, ignore_errors=True)
            raise
        return cls(path)

    @property
    def domain(self) -> str:
        return self.anchor().domain

    def anchor(self) -> TrustAnchor:
        data = files.read_own(self.path / "ca.pem", _SIZE_LIMIT, ConfigurationError("no ca.pem"))
        (der,) = from_pem(data)
        return TrustAnchor.load(der)

    def store(self) -> Store:
        return Store.open(self.path / RECORD)

    def node(self) -> NodeHome:
        return NodeHome(self.path / NODE, OWN_NODE)

    def unlock(self, passphrase: str) -> SigningAuthority:
        return self.open(self.load_key(passphrase))

    def open(self, signer: Signer) -> SigningAuthority:
        authority = Authority(signer, self.anchor().certificate, self.intermediate())
        return SigningAuthority(authority, self.store(), self.path)

    def load_key(self, secret: str, modules: Collection[str] | None = None) -> Signer:
        """The key: in a file that `secret` decrypts, or in the token for which it is the PIN."""
        # `modules`: those of PKCS#11 that the operator named; by default those named for the home.
        uri = self.key_uri()
        if uri is None:
            return KeySigner(private_keys.load_private(self.path / "ca.key", secret))
        home = self.path.parent
        if uri.module not in (trusted(home) if modules is None else modules):
            raise TokenRefused(
                f"the key is in a token behind {uri.module!a}, a module that is not trusted here",
                f"if you know it, write its path into {home / FILE}",
            )
        return TokenSigner.open(uri, secret)

    def key_uri(self) -> KeyUri | None:
        path = self.path / KEY_URI
        if not path.exists():
            return None
        data = files.read_own(path, _MAX_URI, ConfigurationError(f"no {KEY_URI}"))
        return KeyUri.parse(data.decode(errors="replace").strip())

    @property
    def is_intermediate(self) -> bool:
        return self.intermediate() is not None

    def own_key(self) -> PublicKey:
        anchor, der = self.anchor(), self.intermediate()
        return anchor.public_key if der is None else anchor.read_intermediate(der).public_key

    def intermediate(self) -> bytes | None:
        """Its own certificate, if it is an intermediate below the root in ca.pem."""
        path = self.path / "intermediate.pem"
        if not path.exists():
            return None
        (der,) = from_pem(files.read_own(path, _SIZE_LIMIT, ConfigurationError(f"no {path.name}")))
        return der

    def revocation_list(self) -> bytes:
        data = self.store().newest_list()
        if data is None:
            raise ConfigurationError("no revocation list was signed yet", "next: rossec ca refresh")
        return data

    def newest_statement(self) -> tuple[bytes, bytes]:
        """The newest signed list, or tree and its entries; a list has none."""
        data = self.revocation_list()
        if not is_tree(data):
            return data, b""
        tree = open_tree(data, self.anchor().public_key)
        try:
            return data, signing.tree_entries(self.store(), tree).encoded()
        except RevocationRefused:  # something was revoked since, and no list signed yet
            raise ConfigurationError("the entries of the tree are missing", "rossec ca refresh") from None

    def domain_list(self) -> tuple[bytes, DomainList] | None:
        with contextlib.closing(self.store()) as store:
            data = store.domains.newest_list()
        return (data, open_domains(data, self.anchor())) if data else None

    def renewed_until(self, now: int) -> int:
        """Until when grants are renewed whichever master their nodes ask, seconds; 0: they are not."""
        # Each valid master needs a delegation to its present key that it has confirmed to have: what was
        # only signed, or is another master's, renews nothing.
        given = [item for item in delegations(self.path, self.own_key()) if now < item.expires]
        if not given:
            return 0
        with contextlib.closing(self.store()) as store:
            revoked, confirmed = store.revoked_entries(), store.log.subjects(DELIVERED)
            keys = {row.name: row.thumbprint for row in store.identities.valid_masters(now)}
        until: dict[bytes, int] = {}
        for item in given:
            if item.id not in revoked and item.id.hex() in confirmed:
                until[item.holder] = max(until.get(item.holder, 0), item.expires)
        return min((until.get(key, 0) for key in keys.values()), default=0)

    def confirm_delegation(self, delegation: bytes, now: int) -> None:
        with contextlib.closing(self.store()) as store:
            store.log_event(DELIVERED, delegation.hex(), "the master has the delegation", now)

    def count_unlisted(self, now: int) -> int:
        if self.is_intermediate:
            return 0
        return len(signing.missing_entries(self.store(), self.anchor().public_key, now))


def fingerprint(anchor: TrustAnchor) -> str:
    return format_fingerprint(anchor.thumbprint)


def format_fingerprint(thumbprint: bytes) -> str:
    """The fingerprint of a key for people: half its thumbprint, in groups of four."""
    # 128 bits are enough: an attacker needs a second preimage, not a collision.
    digits = thumbprint.hex()
    return " ".join(digits[start : start + 4] for start in range(0, 32, 4))


def check_new(node: NodeHome) -> None:
    if node.path.exists():
        raise ConfigurationError(
            f"{node.name} is in {node.path} already",
            "move that away, or enroll it as every other node: rossec node request",
        )


def enroll_here(authority: SigningAuthority, node: NodeHome, now: int) -> int:
    check_new(node)
    node.create_request(authority.domain)
    bundle = authority.issue(node.request(), now, LIFETIME, source="this host")
    return node.install(bundle, now).not_after
