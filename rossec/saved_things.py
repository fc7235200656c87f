"""What a border router has of its things: the authority's statements, and the secrets of some.

`things/NAME.cose` is the statement about the thing NAME, `things/NAME.key` its OSCORE master secret
(16 octets, 0600), where it has one, and `things/NAME.psk` what may be said about that. A secret is
made here, where it is used, and goes nowhere but to the thing. A statement is stored if it is the
authority's, about a thing of this border router, and not older than the one that is here; whether
it is revoked or expired is for the reader.
"""

import hashlib
import secrets
from pathlib import Path
from typing import Final, NamedTuple

from cryptography.hazmat.primitives.asymmetric import ec

from ca.errors import HintedError, ThingRefused
from ca.keys import key_files
from ca.things.credentials import SECRET_SIZE, ThingSecret
from ca.things.statement import MAX_STATEMENT, ThingStatement, check_thing_name, verify_statement
from rossec import files
from rossec.errors import ConfigurationError
from rossec.home import NodeHome

DIRECTORY: Final = "things"
ROUTER_KEY: Final = ".router.key"  # of no thing: a name has no dot at its beginning
MAX_THINGS: Final = 4096
KID_SIZE: Final = 2
_ATTEMPTS: Final = 64
_LONGEST: Final = 200  # characters of a name that is the name of a file


_Known = tuple[tuple[int, int, int], ThingStatement]


class Loaded(NamedTuple):
    """The statements that are here, by the name of their thing, and why files were left out."""

    statements: dict[str, ThingStatement]
    refused: dict[Path, HintedError]


class ThingFiles:
    """The files of one border router.

    Args:
        home: its directory, with its key and its authority.
    """

    def __init__(self, home: NodeHome) -> None:
        self._home = home
        self._known: dict[Path, _Known] = {}  # of the last `load`
        self.path = home.path / DIRECTORY

    def install(self, data: bytes) -> ThingStatement:
        """Store a statement, and return what it says; a second time changes nothing.

        Raises:
            ThingRefused: forged, malformed, about a thing of another border router, or older than
                the one that is here.
            ConfigurationError: too many things.
        """
        statement = self._verified(data)
        files.make_private_directory(self.path)
        with files.locked_directory(self.path):
            path = self._file(statement.name, "cose")
            if path.exists():
                self._check_not_older(path, statement)
            elif sum(1 for _ in self.path.glob("*.cose")) >= MAX_THINGS:
                raise ConfigurationError(
                    f"this border router has {MAX_THINGS} things, and takes no more",
                    "take them out by: rossec border forget NAME",
                )
            files.replace(path, data)
        return statement

    def load(self) -> Loaded:
        """The statements that are here, and the files that hold none."""
        found: dict[str, ThingStatement] = {}
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

    def _read_once(self, path: Path, known: "dict[Path, _Known]") -> ThingStatement:
        """As `_read`; a file that has not changed since the last time is not verified again."""
        try:
            status = path.stat()
        except OSError:
            return self._read(path)
        state = (status.st_mtime_ns, status.st_ino, status.st_size)
        before = known.get(path)
        same = before is not None and before[0] == state
        statement = before[1] if same and before is not None else self._read(path)
        self._known[path] = (state, statement)
        return statement

    def router_key(self) -> ec.EllipticCurvePrivateKey:
        """The router's key for its things, made at first: it signs nothing, as the node's key does.

        Raises:
            KeyRefused: the file is not a key, or others could have read it.
        """
        files.make_private_directory(self.path)
        path = self.path / ROUTER_KEY
        with files.locked_directory(self.path):
            if not path.exists():
                key_files.write_private(path, key_files.generate())
        return key_files.load_private(path)

    def create_secret(self, name: str) -> bytes:
        """Make the secret of a thing: 16 random octets, in a file that only its owner reads.

        Raises:
            ConfigurationError: it has one already.
        """
        path = self._file(check_thing_name(name), "key")
        files.make_private_directory(self.path)
        secret = secrets.token_bytes(SECRET_SIZE)
        files.create(path, secret)
        return secret

    def free_kid(self) -> bytes:
        """A kid of two octets that no thing here has.

        Raises:
            ConfigurationError: there is none left.
        """
        taken = {each.credential.kid for each in self.load().statements.values()}
        for _ in range(_ATTEMPTS):
            kid = secrets.token_bytes(KID_SIZE)
            if kid not in taken:
                return kid
        raise ConfigurationError("no kid is free", "take things out by: rossec border forget NAME")

    def describe_secret(self, name: str, known: ThingSecret) -> Path:
        """Write what may be said about the secret of a thing, for the authority; returns where."""
        path = self._file(check_thing_name(name), "psk")
        files.replace(path, known.description, 0o644)
        return path

    def secret(self, name: str) -> bytes:
        """The secret of a thing.

        Raises:
            ConfigurationError: it has none here.
            PathRefused: others could have read or written it.
        """
        path = self._file(name, "key")
        missing = ConfigurationError(
            f"there is no secret of {name} in {self.path}", f"rossec border add {name} --psk"
        )
        secret = files.read_own(path, SECRET_SIZE, missing)
        if path.stat().st_mode & 0o077:
            raise ConfigurationError(f"{path} can be read by others", f"chmod 600 {path}")
        return secret

    def secret_of(self, statement: ThingStatement) -> bytes:
        """The secret that a statement is about.

        Raises:
            ThingRefused: the thing has a key, or another secret than the one here.
            ConfigurationError, PathRefused: as `secret`.
        """
        secret = self.secret(statement.name)
        said = statement.credential
        if not isinstance(said, ThingSecret) or not said.matches(secret):
            raise ThingRefused(
                f"the statement about {statement.name} is not about the secret that is here",
                "make the statement anew from what `rossec border add` wrote",
            )
        return secret

    def forget(self, name: str) -> bool:
        """Remove what is here about a thing, its secret too; returns whether there was something.

        The identity of its node stays.

        Raises:
            NameRefused, ThingRefused: not the name of a thing.
        """
        check_thing_name(name)
        paths = [self._file(name, suffix) for suffix in ("cose", "key", "psk")]
        there = [path for path in paths if path.exists()]
        for path in there:
            path.unlink()
        return bool(there)

    def _verified(self, data: bytes) -> ThingStatement:
        anchor = self._home.anchor()
        statement = verify_statement(data, anchor.public_key, domain=anchor.domain)
        if statement.border != key_files.thumbprint(self._home.signer().public_key):
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

    def _check_not_older(self, path: Path, statement: ThingStatement) -> None:
        try:
            held = self._read(path)
        except HintedError:
            return  # damaged, or of a key or an authority that this router had before
        if statement.not_before < held.not_before:
            raise ThingRefused(
                f"the statement about {statement.name} is older than the one that is here",
                "install the newest one; see: rossec ca things",
            )

    def _read(self, path: Path) -> ThingStatement:
        missing = ConfigurationError(f"there is no file {path}")
        return self._verified(files.read_own(path, MAX_STATEMENT, missing))

    def _file(self, name: str, suffix: str) -> Path:
        text = name.lstrip("/").replace("/", ".")
        if len(text) > _LONGEST:
            text = hashlib.sha256(name.encode()).hexdigest()
        return self.path / f"{text}.{suffix}"
