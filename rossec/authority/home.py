"""The directory of an authority: its key, its certificate, its record; `signing` signs."""

import contextlib
import secrets
import shutil
from pathlib import Path
from typing import Final, Self

from cryptography.hazmat.primitives.asymmetric import ec

from ca.authority import Authority, create_root
from ca.certificates import TrustAnchor, from_pem, to_pem
from ca.domains.lists import DomainList, open_domains
from ca.errors import RevocationRefused
from ca.keys import key_files
from ca.keys.hsm import KeyUri, TokenSigner
from ca.keys.signer import KeySigner, Signer
from ca.names import check_domain
from ca.revocation.tree import MAX_TREE_ENTRIES_SIZE, TreeEntries, is_tree, open_tree
from ca.store.record import Store
from rossec import files
from rossec.authority import list_contents
from rossec.authority.signing import OWN_NODE, SigningAuthority, delegations
from rossec.errors import ConfigurationError
from rossec.home import NodeHome

ENTRIES: Final = "revocations.entries"  # of a tree, next to the statement in a master's home
AUDIT_FILE: Final = "audit.log"  # of its service
KEY_URI: Final = "ca.uri"  # names the key, if it is in a token
_MAX_URI: Final = 4096
_SIZE_LIMIT: Final = 256 * 1024
OWN_LIFETIME: Final = 366 * 86400


class AuthorityHome:
    """The directory of the authority: its key, its certificate, its record."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @classmethod
    def at(cls, home: Path) -> Self:
        """The authority below ROSSEC_HOME.

        Raises:
            ConfigurationError: there is none.
        """
        path = home / "ca"
        if not (path / "ca.pem").exists():
            raise ConfigurationError(
                f"there is no authority in {home}", "next: rossec ca init DOMAIN"
            )
        return cls(path)

    @staticmethod
    def check_new(home: Path) -> Path:
        """The directory of a new authority below ROSSEC_HOME.

        Raises:
            ConfigurationError: there is one already.
        """
        path = home / "ca"
        if path.exists():
            raise ConfigurationError(
                f"there is an authority in {path}", "give another ROSSEC_HOME for a second one"
            )
        return path

    @classmethod
    def create(
        cls, home: Path, domain: str, passphrase: str, now: int, uri: KeyUri | None = None
    ) -> Self:
        """Create a new authority with its own node `/ca` and an empty revocation list.

        Its key is in a file encrypted with `passphrase`; with `uri` it is generated in that token,
        and `passphrase` is the PIN.

        Raises:
            TokenRefused: the token cannot generate the key.
            ConfigurationError: there is one already; it is not changed.
        """
        path = cls.check_new(home)
        check_domain(domain)
        key = key_files.generate()
        signer = KeySigner(key) if uri is None else TokenSigner.create(uri, passphrase)
        root = create_root(signer, domain, now=now, serial=secrets.randbits(127) + 1)
        # In a temporary directory: an interrupted creation leaves nothing at `path`.
        staging = path.with_name(f".{path.name}.{secrets.token_hex(8)}")
        try:
            _build(staging, signer, root, now)
            if uri is None:
                key_files.write_private(staging / "ca.key", key, passphrase)
            else:
                files.create(staging / KEY_URI, f"{uri}\n".encode())
            files.commit_directory(staging, path)
        except BaseException:
            shutil.rmtree(staging, ignore_errors=True)
            raise
        return cls(path)

    @property
    def domain(self) -> str:
        """Its trust domain."""
        return self.anchor().domain

    def anchor(self) -> TrustAnchor:
        """Its certificate, as nodes trust it."""
        data = files.read_own(self.path / "ca.pem", _SIZE_LIMIT, ConfigurationError("no ca.pem"))
        (der,) = from_pem(data)
        return TrustAnchor.load(der)

    def store(self) -> Store:
        """Its record."""
        return Store.open(self.path / "ca.db")

    def node(self) -> NodeHome:
        """The node whose identity its tools use to call the master."""
        return NodeHome(self.path / "node", OWN_NODE)

    def unlock(self, passphrase: str) -> SigningAuthority:
        """Load the key.

        Raises:
            PassphraseRefused: the passphrase is wrong.
        """
        return self.open(self.load_key(passphrase))

    def open(self, signer: Signer) -> SigningAuthority:
        """The authority with `signer`, its key.

        Raises:
            IssueRefused: it is another key.
        """
        authority = Authority(signer, self.anchor().certificate, self.intermediate())
        return SigningAuthority(authority, self.store(), self.path)

    def load_key(self, secret: str) -> Signer:
        """The key: in a file that `secret` decrypts, or in the token for which it is the PIN.

        Raises:
            PassphraseRefused, TokenRefused: it is wrong, or there is no such token.
        """
        path = self.path / KEY_URI
        if not path.exists():
            return KeySigner(key_files.load_private(self.path / "ca.key", secret))
        data = files.read_own(path, _MAX_URI, ConfigurationError(f"no {KEY_URI}"))
        return TokenSigner.open(KeyUri.parse(data.decode(errors="replace").strip()), secret)

    @property
    def is_intermediate(self) -> bool:
        """Whether it is an intermediate of a root on another host."""
        return self.intermediate() is not None

    def own_key(self) -> ec.EllipticCurvePublicKey:
        """The key it signs with: that of the root or of the intermediate."""
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
        """The newest signed list.

        Raises:
            ConfigurationError: none was signed yet.
        """
        data = self.store().newest_list()
        if data is None:
            raise ConfigurationError("no revocation list was signed yet", "next: rossec ca refresh")
        return data

    def newest_statement(self) -> tuple[bytes, bytes]:
        """The newest signed list, or tree and its entries; a list has none.

        Raises:
            ConfigurationError: none was signed yet, or the entries are missing.
        """
        data = self.revocation_list()
        return data, self._tree_entries(data) if is_tree(data) else b""

    def _tree_entries(self, data: bytes) -> bytes:
        tree = open_tree(data, self.anchor().public_key)
        with contextlib.suppress(RevocationRefused):
            return list_contents.tree_entries(self.store(), tree).encoded()
        # Written by an older version, which stored them outside the record.
        missing = ConfigurationError("the entries of the tree are missing", "rossec ca refresh")
        data = files.read_own(self.path / ENTRIES, MAX_TREE_ENTRIES_SIZE, missing)
        TreeEntries.read(data).check(tree)
        return data

    def domain_list(self) -> tuple[bytes, DomainList] | None:
        """The newest signed list of domains, and what it says; None: there is none.

        Raises:
            DomainsRefused: it is not signed by the authority.
        """
        with contextlib.closing(self.store()) as store:
            data = store.domains.newest_list()
        return (data, open_domains(data, self.anchor())) if data else None

    def has_delegated(self, now: int) -> bool:
        """Whether the master can renew grants at `now`, by a delegation of this authority."""
        given = [item for item in delegations(self.path, self.own_key()) if now < item.expires]
        if not given:
            return False
        with contextlib.closing(self.store()) as store:
            revoked = store.revoked_entries()
        return any(revoked.isdisjoint((item.id, item.holder)) for item in given)

    def count_unlisted(self, now: int) -> int:
        """The number of recorded revocations that are not in the signed list."""
        if self.is_intermediate:
            return 0
        return len(list_contents.missing_entries(self.store(), self.anchor().public_key, now))


def _build(path: Path, signer: Signer, root: bytes, now: int) -> None:
    """Create everything of a new authority except its key."""
    files.make_private_directory(path)
    with contextlib.closing(Store.create(path / "ca.db")) as store:
        unlocked = SigningAuthority(Authority(signer, root), store, path)
        unlocked.sign_list(now)
        own = NodeHome(path / "node", OWN_NODE)
        own.create_request(unlocked.domain)
        own.install(unlocked.issue(own.request(), now, OWN_LIFETIME), now)
    files.create(path / "ca.pem", to_pem(root), 0o644)


def fingerprint(anchor: TrustAnchor) -> str:
    """The fingerprint of an authority, to compare out of band."""
    return format_fingerprint(anchor.thumbprint)


def format_fingerprint(thumbprint: bytes) -> str:
    """The fingerprint of a key for people: half its thumbprint, in groups of four.

    128 bits are enough: an attacker needs a second preimage, not a collision.
    """
    digits = thumbprint.hex()
    return " ".join(digits[start : start + 4] for start in range(0, 32, 4))
