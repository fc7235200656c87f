"""The side of a command: asks the service that runs in the authority's directory, if one does.

A command opens the record itself, as it does without a service; only the signatures come from the
service, over `ca/service.sock`. Both ends must be of one user. One service of an authority runs at a
time, and none while a backup is restored over it.
"""

import os
import socket
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Final, Self

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import encode_dss_signature

from ca.encoding import Value
from rossec import files
from rossec.authority.home import AuthorityHome
from rossec.authority.keyservice import messages, operations
from rossec.authority.keyservice.messages import SOCKET, ServiceRequest
from rossec.errors import AuthorityLocked, ConfigurationError, KeyServiceFailed, PeerUserRefused
from rossec.host.local_sockets import MAX_PATH, process_lock, require_user

LOCK: Final = "service.lock"
OWNED: Final = (files.Owned(r"service\.lock", kept=False),)  # of a process


def service_lock(directory: Path) -> AbstractContextManager[None]:
    busy = ConfigurationError(
        f"the authority's service runs from {directory}",
        "end it first: Ctrl-C where it runs, or systemctl stop rossec-ca",
    )
    return process_lock(directory / LOCK, busy)


TIMEOUT: Final = 30.0  # seconds for one answer; scrypt takes some tenths of one
_ECDSA: Final = ec.ECDSA(hashes.SHA256())
_HINT: Final = "see: rossec ca status; if it hangs, restart `rossec ca serve`"


class KeyServiceClient:
    def __init__(self, path: Path, sock: socket.socket) -> None:
        self._path = path
        self._socket: socket.socket | None = sock

    @classmethod
    def find(cls, directory: Path) -> Self | None:
        """The service of the authority in `directory`; None: none runs."""
        path = directory / SOCKET
        if len(os.fsencode(path)) > MAX_PATH:
            return None  # no service can listen there
        try:
            return cls(path, _connect(path))
        except (FileNotFoundError, ConnectionRefusedError):
            return None
        except OSError as error:
            raise KeyServiceFailed(f"{path}: {error.strerror or error}", _HINT) from error

    def ask(self, request: ServiceRequest) -> Value:
        data = messages.write_request(request)
        try:
            try:
                return messages.read_answer(self._exchange(data))
            except ConnectionError:  # once more: services are restarted, and drop those that are idle
                self.close()
                return messages.read_answer(self._exchange(data))
        except OSError as error:
            self.close()
            raise KeyServiceFailed(
                f"the authority's service does not answer: {error.strerror or error}", _HINT
            ) from error

    def status(self) -> dict[str, Value]:
        return _as_status(self.ask(ServiceRequest(messages.STATUS)))

    def unlock(self, passphrase: str, seconds: int) -> dict[str, Value]:
        """Unlock it for `seconds`; 0: while it runs. Returns as `status`."""
        return _as_status(self.ask(ServiceRequest(messages.UNLOCK, (seconds, passphrase))))

    def lock(self) -> dict[str, Value]:
        return _as_status(self.ask(ServiceRequest(messages.LOCK)))

    def phone_code(self) -> str:
        code = self.ask(ServiceRequest(messages.PHONE_CODE))
        if not isinstance(code, str):
            raise KeyServiceFailed("the service gives no code", _HINT)
        return code

    def close(self) -> None:
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
    def __init__(self, client: KeyServiceClient, public_key: ec.EllipticCurvePublicKey) -> None:
        self._client = client
        self.public_key = public_key

    def sign(self, message: bytes) -> bytes:
        answer = self._client.ask(ServiceRequest(messages.SIGN, (message,)))
        signature = answer if isinstance(answer, bytes) and len(answer) == 64 else bytes(64)
        r, s = int.from_bytes(signature[:32]), int.from_bytes(signature[32:])
        try:
            # Each one, before it is used: it comes from another process. 64 zeros are no signature.
            self.public_key.verify(encode_dss_signature(r, s), message, _ECDSA)
        except InvalidSignature:
            raise KeyServiceFailed("the service signed with another key", _HINT) from None
        return signature

    def close(self) -> None:
        self._client.close()


def running_signer(home: AuthorityHome) -> RemoteSigner | None:
    """The key of the authority in `home`, as the service that runs there has it; None: none runs."""
    client = KeyServiceClient.find(home.path)
    if client is None:
        return None
    if client.status()["locked"] is not False:
        client.close()
        raise AuthorityLocked("the authority's service is locked", operations.UNLOCK_HINT)
    return RemoteSigner(client, home.own_key())


def _connect(path: Path) -> socket.socket:
    sock = socket.socket(socket.AF_UNIX)
    try:
        sock.settimeout(TIMEOUT)
        sock.connect(str(path))
        # Before anything is sent: what is sent may be the passphrase.
        require_user(sock, {os.geteuid()})
    except PeerUserRefused as error:
        sock.close()
        raise KeyServiceFailed(f"another user listens at {path}", "find out who did that") from error
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
