"""The side of a command: asks the service that runs in the authority's directory, if one does.

A command opens the record itself, as it does without a service; only the signatures come from the
service, which is asked over `ca/service.sock`. Both ends must be of one user. Each signature is
verified here before it is used: a service of another authority's key could sign nothing for this
one. A request that the service ended the connection instead of answering is sent once more, over a
new connection: services are restarted, and drop those that are idle.
"""

import os
import socket
from pathlib import Path
from typing import Final, Self

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import encode_dss_signature

from ca.encoding import Value
from rossec.authority.home import AuthorityHome
from rossec.authority.keyservice import messages
from rossec.authority.keyservice.held_key import UNLOCK_HINT
from rossec.authority.keyservice.messages import SOCKET, Request
from rossec.errors import AuthorityLocked, KeyServiceFailed, PeerUserRefused
from rossec.net.host.peeruid import require_user
from rossec.operation.unix_socket import MAX_PATH

TIMEOUT: Final = 30.0  # seconds for one answer; scrypt takes some tenths of one
_ECDSA: Final = ec.ECDSA(hashes.SHA256())
_HINT: Final = "see: rossec ca status; if it hangs, restart `rossec ca serve`"


class KeyServiceClient:
    """A connection to the service, made when it is needed."""

    def __init__(self, path: Path, sock: socket.socket) -> None:
        self._path = path
        self._socket: socket.socket | None = sock

    @classmethod
    def find(cls, directory: Path) -> Self | None:
        """The service of the authority in `directory`; None: none runs.

        Raises:
            KeyServiceFailed: another user listens there, or it does not answer.
        """
        path = directory / SOCKET
        if len(os.fsencode(path)) > MAX_PATH:
            return None  # no service can listen there
        try:
            return cls(path, _connect(path))
        except (FileNotFoundError, ConnectionRefusedError):
            return None
        except OSError as error:
            raise KeyServiceFailed(f"{path}: {error.strerror or error}", _HINT) from error

    def ask(self, request: Request) -> Value:
        """Send a request, and return what its answer says.

        Raises:
            HintedError: the service refused.
            KeyServiceFailed: it does not answer.
        """
        data = messages.write_request(request)
        try:
            try:
                return messages.read_answer(self._exchange(data))
            except ConnectionError:
                self.close()
                return messages.read_answer(self._exchange(data))
        except OSError as error:
            self.close()
            raise KeyServiceFailed(
                f"the authority's service does not answer: {error.strerror or error}", _HINT
            ) from error

    def status(self) -> dict[str, Value]:
        """What the service says of itself (`KeyOperations.status`).

        Raises:
            HintedError: as `ask`.
        """
        return _as_status(self.ask(Request(messages.STATUS)))

    def unlock(self, passphrase: str, seconds: int) -> dict[str, Value]:
        """Unlock it for `seconds`; 0: while it runs. Returns as `status`.

        Raises:
            PassphraseRefused, TokenRefused: the passphrase or PIN is wrong.
            HintedError: as `ask`.
        """
        return _as_status(self.ask(Request(messages.UNLOCK, (seconds, passphrase))))

    def lock(self) -> dict[str, Value]:
        """Lock it. Returns as `status`."""
        return _as_status(self.ask(Request(messages.LOCK)))

    def phone_code(self) -> str:
        """A one-time code for the console: to look, or to add a phone.

        Raises:
            HintedError: as `ask`.
        """
        code = self.ask(Request(messages.PHONE_CODE))
        if not isinstance(code, str):
            raise KeyServiceFailed("the service gives no code", _HINT)
        return code

    def close(self) -> None:
        """End the connection."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _exchange(self, data: bytes) -> bytes:
        if self._socket is None:
            self._socket = _connect(self._path)
        self._socket.sendall(data)
        size = messages.frame_size(_receive(self._socket, messages.HEAD))
        return _receive(self._socket, size)


class RemoteSigner:
    """A `Signer` whose key the service holds."""

    def __init__(self, client: KeyServiceClient, public_key: ec.EllipticCurvePublicKey) -> None:
        self._client = client
        self._public_key = public_key

    @property
    def public_key(self) -> ec.EllipticCurvePublicKey:
        """The public key."""
        return self._public_key

    def sign(self, message: bytes) -> bytes:
        """As `Signer.sign`.

        Raises:
            AuthorityLocked: the service was locked meanwhile.
            HintedError: as `KeyServiceClient.ask`.
        """
        answer = self._client.ask(Request(messages.SIGN, (message,)))
        if not isinstance(answer, bytes) or not self._verifies(answer, message):
            raise KeyServiceFailed("the service signed with another key", _HINT)
        return answer

    def close(self) -> None:
        """End the connection to the service."""
        self._client.close()

    def _verifies(self, signature: bytes, message: bytes) -> bool:
        half = len(signature) // 2
        r, s = int.from_bytes(signature[:half]), int.from_bytes(signature[half:])
        try:
            self._public_key.verify(encode_dss_signature(r, s), message, _ECDSA)
        except InvalidSignature:
            return False
        return len(signature) == 64


def running_signer(home: AuthorityHome) -> RemoteSigner | None:
    """The key of the authority in `home`, as the service that runs there has it; None: none runs.

    Raises:
        AuthorityLocked: it does not hold the key now.
        KeyServiceFailed: as `KeyServiceClient.find`.
    """
    client = KeyServiceClient.find(home.path)
    if client is None:
        return None
    if client.status()["locked"] is not False:
        client.close()
        raise AuthorityLocked("the authority's service is locked", UNLOCK_HINT)
    return RemoteSigner(client, home.own_key())


def _connect(path: Path) -> socket.socket:
    sock = socket.socket(socket.AF_UNIX)
    try:
        sock.settimeout(TIMEOUT)
        sock.connect(str(path))
        require_user(sock, {os.geteuid()})
    except PeerUserRefused as error:
        sock.close()
        raise KeyServiceFailed(
            f"another user listens at {path}", "find out who did that"
        ) from error
    except BaseException:
        sock.close()
        raise
    return sock


def _receive(sock: socket.socket, size: int) -> bytes:
    data = bytearray()
    while len(data) < size:
        received = sock.recv(size - len(data))
        if not received:
            raise ConnectionResetError("the service ended the connection")
        data += received
    return bytes(data)


def _as_status(value: Value) -> dict[str, Value]:
    if not isinstance(value, dict) or type(value.get("locked")) is not bool:
        raise KeyServiceFailed("the service does not say how it is", _HINT)
    return {str(key): item for key, item in value.items()}
