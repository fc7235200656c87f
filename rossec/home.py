"""The directory of a node below ROSSEC_HOME, and its files. A shell.

Keys are written by `ca.keys.private_keys`, everything else by `rossec.files`; content is verified by
the module of its format. The hints of errors name the next command. When the own identity is over, a
node says that it ended, or that the clock is in doubt: what was signed, and the times of the files,
show how late it is at least. A host whose clock is years ahead has nothing of that time; neither has
one that was off for as long, so that both are told.
"""

import secrets
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Final, Self

from ca import svid
from ca.certificates import Identity, TrustAnchor, everything_ended, from_pem, own_end, to_pem
from ca.errors import (
    CertificateExpired,
    HintedError,
    KeyRefused,
    PathRefused,
    RequestRefused,
    RevocationRefused,
)
from ca.keys import private_keys
from ca.keys.signing import KeySigner, thumbprint
from ca.names import check_name
from ca.revocation.lists import MAX_TREE_ENTRIES_SIZE
from ca.revocation.trust_status import NO_FLOOR, open_statement
from ca.svid import IdentityRequest, build_request, check_request
from grants.filters.hashing import FILTER_KEY_SIZE, check_key_name
from rossec import environment, files
from rossec.channel.edhoc.credentials import Credentials
from rossec.errors import ConfigurationError

_FILES: Final = ("node.pem", "ca.pem", "revocations.cose", "grants")
FILTERS: Final = "filters"  # of a node
FILTER_KEYS: Final = (files.Owned(r"[a-z][a-z0-9_-]{0,31}\.key"),)
_SIZE_LIMIT: Final = 256 * 1024
REVOCATIONS: Final = "revocations.cose"  # the newest list that the node has seen
OWNED: Final = (
    files.Owned(r"node\.key"),
    files.Owned(r"node\.csr"),
    files.Owned(r"(?:node|ca)\.pem", public=True),
    files.Owned(r"grants/[0-9a-f]{1,128}\.grant", kept=False),  # its holder fetches them again
    files.Owned(r"revocations\.(?:cose|entries)", stays=True),
    files.Owned(r"delegation\.cose", stays=True),
)


def ended(name: str, chain: Iterable[bytes], anchor: TrustAnchor, now: int, seen: int) -> CertificateExpired:
    """The refusal of the own identity `name`, whose `chain` is not valid any more at `now`.

    `seen`: how late it is at least, as far as is known without the clock.
    """
    if now > anchor.not_after:
        return everything_ended(anchor.domain, anchor.not_after, now)
    end = min(svid.validity(svid.parse(der))[1] for der in chain)
    return own_end(name, end, now, seen)


def seen_in(directory: Path, anchor: TrustAnchor, revocations: bytes | None) -> int:
    times = [anchor.not_before]
    for name in _FILES:
        path = directory / name
        if path.exists():
            times.append(int(path.stat().st_mtime))
    if revocations is not None:
        with suppress(RevocationRefused):  # of another authority
            times.append(open_statement(revocations, anchor.public_key).issued)
    return max(times)


def has_key(name: str, directory: Path) -> str:
    anew = "for a new key, without the grants of this one, move that directory away first"
    if (directory / "node.pem").exists():
        renew = f"rossec ca renew --expired {name}, then here: rossec node install FILE"
        return f"if its identity is over, where the authority is: {renew}; {anew}"
    return f"its request is {directory / 'node.csr'}; {anew}"


def filter_key(directory: Path, name: str) -> bytes:
    """The key `name`, 32 random bytes; created on first use."""
    path = directory / f"{check_key_name(name)}.key"
    files.make_private_directory(directory)
    with files.locked_directory(directory):
        if not path.exists():
            files.create(path, secrets.token_bytes(FILTER_KEY_SIZE))
    missing = ConfigurationError(f"there is no filter key {name} any more", f"it was {path}")
    try:
        key = files.read_own(path, FILTER_KEY_SIZE, missing)
    except PathRefused as error:  # a peer may read this: no path in it
        raise ConfigurationError(
            f"others could have written the filter key {name}", f"{error}: {error.hint}"
        ) from error
    if len(key) != FILTER_KEY_SIZE:
        raise ConfigurationError(
            # A peer may read this: no path in it.
            f"the filter key {name} is not a key of {FILTER_KEY_SIZE} bytes",
            f"move {path} away: a new one is made, and pseudonyms change",
        )
    return key


class NodeHome:
    """The directory of one node: its key, its identity, its trust anchor, its grants."""

    def __init__(self, path: Path, name: str) -> None:
        self.path = path
        self.name = name

    @classmethod
    def of(cls, home: Path, name: str) -> Self:
        """The directory of the node `name` below ROSSEC_HOME; it need not exist."""
        return cls(home / "nodes" / check_name(name).lstrip("/").replace("/", "."), name)

    @classmethod
    def find(cls, home: Path, name: str) -> Self:
        """The directory of the identity that covers `name`.

        Its own if there is one; else that of the longest name with a wildcard tail that covers it;
        else its own, which does not exist, for the hints of errors.
        """
        own = cls.of(home, name)
        if own.path.exists():
            return own
        for end in range(len(name) - 2, name.rindex("/") + 1, -1):
            if name[end] == "_" and (found := cls.of(home, name[:end])).is_wildcard():
                return found
        return own

    @classmethod
    def for_bundle(cls, home: Path, bundle: bytes, now: int) -> tuple[Self, TrustAnchor]:
        """The directory of the node a signed identity is for, and the authority that signed it."""
        chain, root = _split(bundle)
        anchor = TrustAnchor.load(root)
        return cls.of(home, anchor.verify(chain, now).name), anchor

    @property
    def request_path(self) -> Path:
        return self.path / "node.csr"

    def create_request(self, domain: str, *, wildcard: bool = False) -> IdentityRequest:
        """Make the key and the request for an identity; with `wildcard`, for anonymous nodes too."""
        if (self.path / "node.key").exists():
            raise KeyRefused(f"{self.name} has a key already, in {self.path}", has_key(self.name, self.path))
        files.make_private_directory(self.path)
        key = private_keys.generate()
        request = build_request(KeySigner(key), domain, self.name, wildcard=wildcard)
        private_keys.write_private(self.path / "node.key", key)
        files.replace(self.request_path, request, 0o644)
        return check_request(request, domain, wildcard=wildcard)

    def screen_request(self, domain: str, *, wildcard: bool = False) -> bytes:
        """A new request (DER) with this node's key, made if there is none; it is not written.

        A request is answered once, so every code on a screen has its own. The request on disk and
        the label printed from it do not change.
        """
        if not (self.path / "node.key").exists():
            self.create_request(domain, wildcard=wildcard)
        return build_request(self.signer(), domain, self.name, wildcard=wildcard)

    def label_request(self, domain: str, *, wildcard: bool = False) -> bytes:
        """The request (DER) on disk, made if there is none: the one a printed label is for."""
        if not (self.path / "node.key").exists():
            self.create_request(domain, wildcard=wildcard)
        request = self.request()
        own = thumbprint(self.signer().public_key)
        if check_request(request, domain, wildcard=wildcard).thumbprint != own:
            raise ConfigurationError(
                f"{self.request_path} is for another key than {self.name} has here",
                f"move {self.path} away and begin anew",
            )
        return request

    def join_request(self, domain: str, *, wildcard: bool = False) -> bytes:
        """The request (DER) on disk, to be sent until it has its identity; made if there is none.

        With the key that is here: a crash may have lost the request, or it is for another domain.
        """
        key = self.path / "node.key"
        if key.exists() and not key.stat().st_size:  # a crash, before the key was in its new file
            key.unlink()
        if key.exists() and not self._is_open(domain, wildcard=wildcard):
            made = build_request(self.signer(), domain, self.name, wildcard=wildcard)
            files.replace(self.request_path, made, 0o644)
        return self.label_request(domain, wildcard=wildcard)

    def _is_open(self, domain: str, *, wildcard: bool) -> bool:
        if not self.request_path.exists() or (self.path / "node.pem").exists():
            return False
        try:
            found = check_request(self.request(), domain, wildcard=wildcard)
        except RequestRefused:
            return False
        return found.wildcard == wildcard

    def signer(self) -> KeySigner:
        return KeySigner(private_keys.load_private(self.path / "node.key"))

    def request(self) -> bytes:
        return self._read("node.csr", f"next: rossec node request {self.name}")

    def install(self, bundle: bytes, now: int) -> Identity:
        """Store a signed identity and trust its authority."""
        chain, root = _split(bundle)
        anchor = TrustAnchor.load(root)
        identity = anchor.verify(chain, now)
        own = thumbprint(self.signer().public_key)
        if identity.name != self.name or identity.thumbprint != own:
            raise ConfigurationError(
                f"this identity is for {identity.name} with another key than {self.name} has here",
                f"sign the request in {self.request_path}",
            )
        if (self.path / "ca.pem").exists() and self.anchor().thumbprint != anchor.thumbprint:
            raise ConfigurationError(
                f"{self.name} trusts another authority already",
                f"to change it, move {self.path} away and enroll the node anew",
            )
        # The identity last: its file is what says that the node is enrolled.
        files.replace(self.path / "ca.pem", to_pem(root), 0o644)
        files.replace(self.path / "node.pem", bundle, 0o644)
        files.make_private_directory(self.path / "grants")
        return identity

    def anchor(self) -> TrustAnchor:
        (der,) = from_pem(self._read("ca.pem", self._enroll))
        return TrustAnchor.load(der)

    def identity(self, now: int) -> Identity:
        """This node's own identity, verified."""
        anchor, own = self.anchor(), self.credentials()
        try:
            identity = anchor.verify(own.chain, now)
        except CertificateExpired as error:
            seen = seen_in(self.path, anchor, self.load_revocations())
            raise ended(self.name, own.chain, anchor, now, seen) from error
        if identity.name != self.name:
            raise ConfigurationError(
                f"{self.path} holds the identity of {identity.name}, not of {self.name}",
                f"next: rossec node request {self.name}",
            )
        if identity.thumbprint != thumbprint(own.signer.public_key):
            raise ConfigurationError(
                f"the key and the certificate in {self.path} do not belong together",
                "restore the key; without it move the directory away and enroll the node anew",
            )
        return identity

    def is_wildcard(self) -> bool:
        """Whether an identity with a wildcard tail is installed; verified when it is used."""
        if not (self.path / "node.pem").exists():
            return False
        chain, _ = _split(self._read("node.pem", ""))
        return svid.is_wildcard(chain[0])

    def credentials(self) -> Credentials:
        chain, _ = _split(self._read("node.pem", self._enroll))
        return Credentials(self.signer(), chain, shared=svid.is_wildcard(chain[0]))

    def grants(self) -> list[bytes]:
        return [self.read_grant(path) for path in self.grant_files()]

    def grant_files(self) -> list[Path]:
        """Their paths; the files need not hold grants."""
        return sorted((self.path / "grants").glob("*.grant"))

    def read_grant(self, path: Path) -> bytes:
        """One of `grant_files`."""
        return files.read_own(path, _SIZE_LIMIT, self._missing(path, ""))

    def add_grant(self, grant_id: bytes, data: bytes) -> None:
        files.make_private_directory(self.path / "grants")
        files.replace(self.grant_file(grant_id), data)

    def grant_file(self, grant_id: bytes) -> Path:
        return self.path / "grants" / f"{grant_id.hex()}.grant"

    def load_revocations(self) -> bytes | None:
        return self._read_if_present(REVOCATIONS, _SIZE_LIMIT)

    def save_revocations(self, data: bytes) -> None:
        """Store a revocation list; durable on return.

        Processes of one identity share this directory: an older list never replaces a newer one.
        """
        with files.locked_directory(self.path):
            held = self.load_revocations()
            if held is None or self._number(held) <= self._number(data):
                files.replace(self.path / REVOCATIONS, data)

    def _number(self, data: bytes) -> tuple[int, int]:
        try:
            return open_statement(data, self.anchor().public_key).number
        except HintedError:
            return NO_FLOOR

    def load_entries(self) -> bytes | None:
        return self._read_if_present("revocations.entries", MAX_TREE_ENTRIES_SIZE)

    def save_entries(self, data: bytes) -> None:
        files.replace(self.path / "revocations.entries", data)

    def load_delegation(self) -> bytes | None:
        return self._read_if_present("delegation.cose", _SIZE_LIMIT)

    def save_delegation(self, data: bytes) -> None:
        files.replace(self.path / "delegation.cose", data)

    def filter_key(self, name: str) -> bytes:
        return filter_key(self.path / FILTERS, name)

    @property
    def _enroll(self) -> str:
        if not (self.path / "node.key").exists():
            return environment.missing_node(self.path.parent.parent, self.name)
        return (
            f"next: rossec ca sign {self.request_path}, then rossec node install FILE;"
            " or go on with an invitation: rossec node join"
        )

    def _read(self, name: str, hint: str) -> bytes:
        path = self.path / name
        return files.read_own(path, _SIZE_LIMIT, self._missing(path, hint))

    def _read_if_present(self, name: str, limit: int) -> bytes | None:
        path = self.path / name
        return files.read_own(path, limit, self._missing(path, "")) if path.exists() else None

    def _missing(self, path: Path, hint: str) -> ConfigurationError:
        return ConfigurationError(f"{self.name} has no {path.name} in {path.parent}", hint)


def _split(bundle: bytes) -> tuple[tuple[bytes, ...], bytes]:
    # The chain that a node sends, and the root, which it does not send.
    match from_pem(bundle):
        case (leaf, root):
            return (leaf,), root
        case (leaf, intermediate, root):
            return (leaf, intermediate), root
        case found:
            raise ConfigurationError(
                f"a bundle of {len(found)} certificates where two or three are expected",
                "take the file `rossec ca sign` wrote",
            )
