"""EDHOC of things (RFC 9528, method 3, suite 2), as the responder: lakers behind a boundary.

Both sides have a static P-256 key, named by a kid. lakers may panic on malformed input, as an exception
that is no `Exception`: nothing of it leaves this module. Numbers are sections of RFC 9528.
"""

import re
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, TypeVar

import lakers
from cryptography.hazmat.primitives.asymmetric import ec

from ca.encoding import decode
from ca.errors import EncodingError
from ca.keys.signing import thumbprint
from ca.things import ThingKey
from rossec.border.messages import KEY_SIZE, SALT_SIZE, OscoreContext
from rossec.errors import DatagramRefused, ThingError

MAX_PENDING: Final = 256
PENDING_FOR: Final = 20.0  # seconds; message_1 is repeated for longer, but gets a new answer
MAX_MESSAGE_1: Final = 128  # octets; without extensions it has 37
MAX_MESSAGE_3: Final = 128
ID_SIZE: Final = 3  # of C_R: what a thing is called in its contexts
_KEY, _SALT = 0, 1  # labels of the exporter, RFC 9528 appendix A.1
_TRIES: Final = 16
_KIDS: Final = 24  # a kid of one octet below this takes the least room in messages
_POINT: Final = 32  # octets of x
_SUITE: Final = rb"(?:[\x00-\x17]|\x18[\x18-\xff])"
_BEFORE_POINT: Final = re.compile(rb"\x03(?:%s|[\x82-\x97]%s{2,23})\x58\x20" % (_SUITE, _SUITE), re.DOTALL)
_LEAVES: Final = (KeyboardInterrupt, SystemExit, GeneratorExit)
ResultT = TypeVar("ResultT")
FindKey = Callable[[bytes], ThingKey | None]


class HandshakeCompleted(NamedTuple):
    key: ThingKey
    context: OscoreContext
    message_4: bytes


@dataclass(slots=True)
class _Pending:
    responder: Any
    peer_id: bytes
    source: Hashable
    message_1: bytes
    message_2: bytes
    until: float


class StaticKey:
    """The key of a border router for its things, which signs nothing."""

    def __init__(self, key: ec.EllipticCurvePrivateKey) -> None:
        self.private: Final = key.private_numbers().private_value.to_bytes(32)
        kid = bytes((thumbprint(key.public_key())[0] % _KIDS,))
        self.credential: Final = ThingKey.of(key.public_key(), kid)


class Handshakes:
    """The handshakes under way; `is_taken`: an ID is in use, by a context or by a thing with a secret."""

    def __init__(
        self, own: StaticKey, find: FindKey, is_taken: Callable[[bytes], bool], random: Callable[[int], bytes]
    ) -> None:
        self._own, self._find, self._is_taken = own, find, is_taken
        self._random = random
        self._pending: OrderedDict[bytes, _Pending] = OrderedDict()
        self._answered: dict[tuple[Hashable, bytes], bytes] = {}
        self._decoy = ThingKey.of(ec.generate_private_key(ec.SECP256R1()).public_key(), b"\0")

    def __len__(self) -> int:
        return len(self._pending)

    def repeated(self, message_1: bytes, source: Hashable) -> bytes | None:
        known = self._answered.get((source, message_1))
        return None if known is None else self._pending[known].message_2

    def begin(self, message_1: bytes, source: Hashable, now: float) -> bytes:
        if len(message_1) > MAX_MESSAGE_1:
            raise ThingError(f"a message_1 of {len(message_1)} octets")
        # 5.2.3: G_X, after METHOD and SUITES_I. lakers would panic on a point that is not on the curve, and
        # write a stack trace to stderr; what else is wrong it refuses.
        head = _BEFORE_POINT.match(message_1)
        x = message_1[head.end() : head.end() + _POINT] if head else b""
        try:
            ec.EllipticCurvePublicKey.from_encoded_point(ec.SECP256R1(), b"\x02" + x)
        except ValueError:
            raise ThingError("no key that is on the curve") from None
        # 5.2.3: process message_1; a critical EAD that is not known ends the session (3.8).
        responder = lakers.EdhocResponder(r=self._own.private, cred_r=self._own.credential.ccs)
        raw_id, extensions = _guarded(responder.process_message_1, message_1)
        peer_id = bytes(raw_id)
        _check_extensions(extensions)
        # 5.3.2: choose C_R, another than C_I (RFC 9528 section 3.3.3), and of no context or handshake here.
        for _ in range(_TRIES):
            own_id = self._random(ID_SIZE)
            if own_id != peer_id and own_id not in self._pending and not self._is_taken(own_id):
                break
        else:
            raise ThingError("no free ID")
        message_2 = bytes(
            _guarded(responder.prepare_message_2, lakers.CredentialTransfer.ByReference, own_id, None)
        )
        self.expire(now)
        if len(self._pending) >= MAX_PENDING:  # the oldest makes room: nobody here is authenticated yet
            self._drop(next(iter(self._pending)))
        self._pending[own_id] = _Pending(responder, peer_id, source, message_1, message_2, now + PENDING_FOR)
        self._answered[source, message_1] = own_id
        return message_2

    def finish(self, own_id: bytes, message_3: bytes, now: float) -> HandshakeCompleted:
        self.expire(now)
        pending = self._drop(own_id)
        try:  # one byte string and nothing after it: lakers does not look
            is_message_3 = isinstance(decode(message_3, limit=MAX_MESSAGE_3), bytes)
        except EncodingError:
            is_message_3 = False
        if pending is None or not is_message_3:
            raise ThingError("no such handshake, or no message_3")
        # 5.4.3: process message_3: decrypt, read ID_CRED_I, verify by the credential that it names. One that
        # nobody has costs the same work and gets the same answer as a wrong proof.
        responder = pending.responder
        id_cred, extensions = _guarded(responder.parse_message_3, message_3)
        _check_extensions(extensions)
        try:
            named = decode(bytes(id_cred), limit=MAX_MESSAGE_3)
        except EncodingError:
            named = None
        kid = named.get(4) if isinstance(named, dict) and len(named) == 1 else None
        key = self._find(kid if isinstance(kid, bytes) else b"")
        _guarded(responder.verify_message_3, (self._decoy if key is None else key).ccs)
        if key is None:
            raise ThingError("the key of no thing that is served here")
        # 5.5.2: message_4; appendix A.1: the context, whose IDs are C_I and C_R.
        message_4 = bytes(_guarded(responder.prepare_message_4))
        secret = bytes(_guarded(responder.edhoc_exporter, _KEY, [], KEY_SIZE))
        salt = bytes(_guarded(responder.edhoc_exporter, _SALT, [], SALT_SIZE))
        try:
            context = OscoreContext(secret, salt, pending.peer_id, own_id)
        except DatagramRefused as error:
            raise ThingError(str(error)) from None
        return HandshakeCompleted(key, context, message_4)

    def expire(self, now: float) -> None:
        while self._pending and next(iter(self._pending.values())).until <= now:
            self._drop(next(iter(self._pending)))

    def _drop(self, own_id: bytes) -> _Pending | None:
        pending = self._pending.pop(own_id, None)
        if pending is not None:
            self._answered.pop((pending.source, pending.message_1), None)
        return pending


def _check_extensions(extensions: Any) -> None:
    if any(each.is_critical() for each in extensions or ()):
        raise ThingError("a critical extension that is not known")


def _guarded(function: Callable[..., Any], *arguments: object) -> Any:
    try:
        return function(*arguments)
    except _LEAVES:
        raise
    except BaseException as error:  # noqa: BLE001 - PanicException of pyo3 is no Exception
        raise ThingError(f"EDHOC: {str(error)[:80]}") from None
