"""What is saved of statements: revocations, foreign domains, and the things of a border router.

`domains.cose` is the list of foreign domains, `foreign/DOMAIN.cose` the revocation list of one of
them. Processes of one identity share the directory: an older list never replaces a newer one.
"""

import secrets
from hashlib import sha256
from pathlib import Path
from typing import Final, NamedTuple

from cryptography.hazmat.primitives.asymmetric import ec

from ca import things
from ca.certificates import TrustAnchor
from ca.domains import MAX_LIST as MAX_DOMAINS
from ca.domains import Anchors, open_domains
from ca.errors import HintedError, ThingRefused
from ca.keys import private_keys
from ca.keys.signing import thumbprint
from ca.names import check_domain
from ca.revocation.lists import MAX_LIST
from ca.revocation.trust_status import NO_FLOOR, Revocations, TrustStatus, open_statement
from rossec import files
from rossec.errors import ConfigurationError
from rossec.home import NodeHome

OWNED: Final = (
    files.Owned(r"domains\.cose", stays=True),
    files.Owned(r"foreign/[a-z0-9_-][a-z0-9._-]{0,199}\.cose", stays=True),
)
LONGEST: Final = 200  # characters of a domain, or a name, that is the name of a file
DIRECTORY: Final = "things"
ROUTER_KEY: Final = ".router.key"  # of no thing: a name has no dot at its beginning
MAX_THINGS: Final = 4096
KID_SIZE: Final = 2
_ATTEMPTS: Final = 64

_Known = tuple[tuple[int, int, int], things.ThingStatement]


def saved_revocations(home: NodeHome, anchor: TrustAnchor, now: int) -> Revocations:
    """The newest list that the node in `home` has seen, not yet confirmed."""
    revocations = Revocations(anchor.public_key)
    saved = home.load_revocations()
    if saved is not None:
        revocations.update(saved, now)
    return revocations


class DomainFiles:
    """What the node, or master, in `home` had of foreign domains when it stopped; older is refused."""

    def __init__(self, home: NodeHome, anchor: TrustAnchor) -> None:
        self._path = home.path
        self._anchor = anchor

    def load_domains(self) -> bytes | None:
        return _read(self._path / "domains.cose", MAX_DOMAINS)

    def save_domains(self, data: bytes) -> None:
        """Store a verified list of domains; durable on return."""
        with files.locked_directory(self._path):
            held = self.load_domains()
            if held is None or self._number(held) <= self._number(data):
                files.replace(self._path / "domains.cose", data)

    def load_foreign(self, domain: str) -> bytes | None:
        return _read(self._foreign(domain), MAX_LIST)

    def save_foreign(self, root: TrustAnchor, data: bytes) -> None:
        """Store a verified revocation list of the domain of `root`; durable on return.

        One of another root of that domain is replaced.
        """
        path = self._foreign(root.domain)
        files.make_private_directory(path.parent)
        with files.locked_directory(self._path):
            held = self.load_foreign(root.domain)
            if held is None or _list_number(held, root) <= _list_number(data, root):
                files.replace(path, data)

    def anchors(self) -> Anchors:
        """The own authority, with the list of domains that was saved."""
        anchors, saved = Anchors(self._anchor), self.load_domains()
        if saved is not None:
            anchors.update(saved)
        return anchors

    def trust_status(self, anchors: Anchors, own: Revocations, now: int) -> TrustStatus:
        """The own list and those of the listed domains that were saved, none of them confirmed."""
        trust_status = TrustStatus(anchors, own)
        self.restore(trust_status, now)
        return trust_status

    def restore(self, trust_status: TrustStatus, now: int) -> None:
        """Load the saved list of each listed domain of which none is held yet; raises likewise."""
        for listed in trust_status.anchors.all_listed:
            held = trust_status.foreign(listed.entry.domain)
            saved = None if held is None or held.data else self.load_foreign(listed.entry.domain)
            if saved is not None:
                trust_status.restore(listed.entry.domain, saved, now)

    def _number(self, data: bytes) -> tuple[int, int]:
        try:
            return open_domains(data, self._anchor).number
        except HintedError:
            return NO_FLOOR

    def _foreign(self, domain: str) -> Path:
        name = check_domain(domain)
        if len(name) > LONGEST:
            name = sha256(name.encode()).hexdigest()
        return self._path / "foreign" / f"{name}.cose"


def _list_number(data: bytes, root: TrustAnchor) -> tuple[int, int]:
    try:
        return open_statement(data, root.public_key).number
    except HintedError:
        return NO_FLOOR


def _read(path: Path, limit: int) -> bytes | None:
    missing = ConfigurationError(f"there is no {path.name} in {path.parent}")
    return files.read_own(path, limit, missing) if path.exists() else None


class Loaded(NamedTuple):
    statements: dict[str, things.ThingStatement]
    refused: dict[Path, HintedError]


class ThingFiles:
    """What a border router has of its things: the authority's statements, and the secrets of some.

    `things/NAME.cose` is the statement about the thing NAME, `things/NAME.key` its OSCORE master
    secret (16 octets, 0600), where it has one, and `things/NAME.psk` what may be said about that. A
    secret is made here, where it is used, and goes nowhere but to the thing. A statement is stored
    if it is the authority's, about a thing of this border router, and not older than the one that
    is here; whether it is revoked or expired is for the reader.
    """

    def __init__(self, home: NodeHome) -> None:
        self._home = home
        self._known: dict[Path, _Known] = {}  # of the last `load`
        self.path = home.path / DIRECTORY

    def install(self, data: bytes) -> things.ThingStatement:
        """Store a statement, and return what it says; a second time changes nothing."""
        statement = self._verified(data)
        files.make_private_directory(self.path)
        with files.locked_directory(self.path):
            path = self._file(statement.name, "cose")
            if path.exists():
                try:
                    held = self._read(path)
                except HintedError:  # damaged, or of a key or an authority that this router had before
                    held = None
                # Restored or repeated it would bring a former key back (attack `thing-statement`).
                if held is not None and statement.not_before < held.not_before:
                    raise ThingRefused(
                        f"the statement about {statement.name} is older than the one that is here",
                        "install the newest one; see: rossec ca things",
                    )
            elif sum(1 for _ in self.path.glob("*.cose")) >= MAX_THINGS:
                raise ConfigurationError(
                    f"this border router has {MAX_THINGS} things, and takes no more",
                    "take them out by: rossec border forget NAME",
                )
            files.replace(path, data)
        return statement

    def load(self) -> Loaded:
        """The statements that are here, and the files that hold none."""
        found: dict[str, things.ThingStatement] = {}
        refused: dict[Path, HintedError] = {}
        known, self._known = self._known, {}
        for path in sorted(self.path.glob("*.cose")):
            try:
                statement = self._read_once(path, known)
                if path != self._file(statement.name, "cose"):
                    raise ThingRefused(f"{path.name} is about {statement.name}", "rename the file")
                found[statement.name] = statement
            except HintedError as error:
                refused[path] = error
        return Loaded(found, refused)

    def _read_once(self, path: Path, known: "dict[Path, _Known]") -> things.ThingStatement:
        # As `_read`; a file that has not changed since the last time is not verified again.
        try:
            status = path.stat()
        except OSError:
            return self._read(path)
        state = (status.st_mtime_ns, status.st_ino, status.st_size)
        before = known.get(path)
        statement = before[1] if before is not None and before[0] == state else self._read(path)
        self._known[path] = (state, statement)
        return statement

    def router_key(self) -> ec.EllipticCurvePrivateKey:
        """The router's key for its things, made at first: it signs nothing, as the node's key does."""
        files.make_private_directory(self.path)
        path = self.path / ROUTER_KEY
        with files.locked_directory(self.path):
            if not path.exists():
                private_keys.write_private(path, private_keys.generate())
        return private_keys.load_private(path)

    def create_secret(self, name: str) -> bytes:
        """Make the secret of a thing: 16 random octets, in a file that only its owner reads."""
        path = self._file(things.check_thing_name(name), "key")
        files.make_private_directory(self.path)
        secret = secrets.token_bytes(things.SECRET_SIZE)
        files.create(path, secret)
        return secret

    def free_kid(self) -> bytes:
        """A kid of two octets that no thing here has."""
        taken = {each.credential.kid for each in self.load().statements.values()}
        for _ in range(_ATTEMPTS):
            kid = secrets.token_bytes(KID_SIZE)
            if kid not in taken:
                return kid
        raise ConfigurationError("no kid is free", "take things out by: rossec border forget NAME")

    def describe_secret(self, name: str, known: things.ThingSecret) -> Path:
        """Write what may be said about the secret of a thing, for the authority; returns where."""
        path = self._file(things.check_thing_name(name), "psk")
        files.replace(path, known.description, 0o644)
        return path

    def secret(self, name: str) -> bytes:
        """The secret of a thing."""
        path = self._file(name, "key")
        missing = ConfigurationError(
            f"there is no secret of {name} in {self.path}", f"rossec border add {name} --psk"
        )
        secret = files.read_own(path, things.SECRET_SIZE, missing)
        if path.stat().st_mode & 0o077:
            raise ConfigurationError(f"{path} can be read by others", f"chmod 600 {path}")
        return secret

    def secret_of(self, statement: things.ThingStatement) -> bytes:
        """The secret that a statement is about."""
        secret = self.secret(statement.name)
        said = statement.credential
        if not isinstance(said, things.ThingSecret) or not said.matches(secret):
            raise ThingRefused(
                f"the statement about {statement.name} is not about the secret that is here",
                "make the statement anew from what `rossec border add` wrote",
            )
        return secret

    def forget(self, name: str) -> bool:
        """Remove what is here about a thing, its secret too; returns whether there was something.

        The identity of its node stays.
        """
        things.check_thing_name(name)
        paths = [self._file(name, suffix) for suffix in ("cose", "key", "psk")]
        there = [path for path in paths if path.exists()]
        for path in there:
            path.unlink()
        return bool(there)

    def _verified(self, data: bytes) -> things.ThingStatement:
        anchor = self._home.anchor()
        statement = things.verify_statement(data, anchor.public_key, domain=anchor.domain)
        if statement.border != thumbprint(self._home.signer().public_key):
            raise ThingRefused(
                f"the statement about {statement.name} is for another border router",
                f"for this one: rossec ca thing {statement.name} --border {self._home.name}",
            )
        if statement.name == self._home.name:
            raise ThingRefused(
                f"the statement is about {statement.name}, which is the border router",
                "a thing has a name of its own: /things/lamp",
            )
        return statement

    def _read(self, path: Path) -> things.ThingStatement:
        missing = ConfigurationError(f"there is no file {path}")
        return self._verified(files.read_own(path, things.MAX_STATEMENT, missing))

    def _file(self, name: str, suffix: str) -> Path:
        text = name.lstrip("/").replace("/", ".")
        if len(text) > LONGEST:
            text = sha256(name.encode()).hexdigest()
        return self.path / f"{text}.{suffix}"
