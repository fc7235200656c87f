"""CoAP messages as bytes (RFC 7252 section 3), their repetition, and OSCORE contexts (RFC 8613). Pure.

aiocoap's codec behind a size limit: whatever its decoder raises about foreign bytes is one error here.
Contexts live in memory only. After a restart of either side there is none, and a new one is derived
from fresh random values, so no sequence number is ever used twice.
"""

import heapq
import hmac
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count
from typing import Any, Final

from aiocoap import Message, oscore
from aiocoap.numbers.types import Type

from ca.encoding import decode, encode
from ca.errors import EncodingError
from rossec.errors import DatagramRefused

MAX_DATAGRAM: Final = 1280  # octets; IPv6's smallest MTU, more than a block of 1 KiB sealed
TOKEN_SIZE: Final = 4
CON, NON, ACK, RST = Type.CON, Type.NON, Type.ACK, Type.RST
OBSERVE, DEREGISTER = 0, 1  # RFC 7641 section 2
_SLACK: Final = 256
ACK_TIMEOUT: Final = 2.0  # seconds; longer by up to a half, at random
MAX_RETRANSMIT: Final = 4
Address = tuple[Any, ...]
Send = Callable[[bytes, Address], None]
WINDOW: Final = 32
SALT_SIZE: Final = 8
KEY_SIZE: Final = 16
MAX_ID: Final = 7  # octets of an ID: 6 less than a nonce has (RFC 8613 section 3.3)
_ALGORITHM: Final = oscore.algorithms["AES-CCM-16-64-128"]
_HASH: Final = oscore.hashfunctions["sha256"]
_H: Final = 0x10  # flag: there is a kid context
RequestId = Any
NONCE_SIZE: Final = 8  # of ID1 and R3
R2_SIZE: Final = 16  # milliseconds (6), random (2), tag (8)
MAX_ID1: Final = 32
LIFETIME: Final = 30_000  # milliseconds in which the thing answers R2
BORDER_ID: Final = b""  # the border router's sender ID in contexts of a secret
_SALT: Final = b""
_TIME: Final = 6


def read(data: bytes) -> Message:
    if not 4 <= len(data) <= MAX_DATAGRAM:
        raise DatagramRefused(f"a datagram of {len(data)} octets")
    if data[0] & 0x0F > 8 or (data[1] == 0 and len(data) != 4):
        raise DatagramRefused("a token that is too long, or an empty message that is not empty")
    try:
        return Message.decode(data)
    except Exception as error:  # noqa: BLE001 - the codec's errors have no common base
        raise DatagramRefused(f"not a CoAP message: {type(error).__name__}") from None


def write(message: Message) -> bytes:
    data: bytes = message.encode()
    return data


def empty(kind: Type, mid: int) -> bytes:
    return bytes((0x40 | kind << 4, 0)) + mid.to_bytes(2)


def is_empty(message: Message) -> bool:
    return int(message.code) == 0


def number_of(message: Message) -> int:
    return int(message.mid or 0)


def answer(request: Message, response: Message, mid: int) -> Message:
    response.token = request.token
    confirmed = request.mtype == CON
    response.mtype = ACK if confirmed else NON
    response.mid = number_of(request) if confirmed else mid
    return response


class Timers:
    """One list of what is due for all things of a border router: none has a task of its own."""

    def __init__(self) -> None:
        self._heap: list[tuple[float, int]] = []
        self._calls: dict[int, Callable[[float], None]] = {}
        self._numbers = count()

    def __len__(self) -> int:
        return len(self._calls)

    @property
    def next_due(self) -> float | None:
        while self._heap and self._heap[0][1] not in self._calls:
            heapq.heappop(self._heap)
        return self._heap[0][0] if self._heap else None

    def at(self, due: float, call: Callable[[float], None]) -> int:
        number = next(self._numbers)
        self._calls[number] = call
        heapq.heappush(self._heap, (due, number))
        return number

    def cancel(self, number: int) -> None:
        # Do not make this call; one that was made, or cancelled, is ignored.
        self._calls.pop(number, None)
        if len(self._heap) > _SLACK + 2 * len(self._calls):  # most of what waits was cancelled
            self._heap = [entry for entry in self._heap if entry[1] in self._calls]
            heapq.heapify(self._heap)

    def run(self, now: float) -> None:
        while (due := self.next_due) is not None and due <= now:
            _, number = heapq.heappop(self._heap)
            self._calls.pop(number)(now)


@dataclass(slots=True)
class _Transmission:
    data: bytes
    failed: Callable[[], None]
    pause: float
    left: int
    timer: int


class Transmissions:
    """Confirmable messages until they are acknowledged (RFC 7252 section 4.2).

    A reset has four octets and nobody's signature, so it counts as not delivered.
    """

    def __init__(self, send: Send, timers: Timers, rand: Callable[[], float]) -> None:
        self._send, self._timers, self._rand = send, timers, rand
        self._open: dict[tuple[Address, int], _Transmission] = {}

    def __len__(self) -> int:
        return len(self._open)

    def send(self, data: bytes, mid: int, address: Address, now: float, failed: Callable[[], None]) -> None:
        pause = ACK_TIMEOUT * (1 + self._rand() / 2)
        key = (address, mid)
        self.acknowledge(address, mid)
        timer = self._timers.at(now + pause, lambda at: self._again(key, at))
        self._open[key] = _Transmission(data, failed, pause, MAX_RETRANSMIT, timer)
        self._send(data, address)

    def acknowledge(self, address: Address, mid: int) -> None:
        found = self._open.pop((address, mid), None)
        if found is not None:
            self._timers.cancel(found.timer)

    def _again(self, key: tuple[Address, int], now: float) -> None:
        found = self._open[key]
        if found.left == 0:
            del self._open[key]
            found.failed()
            return
        found.left -= 1
        found.pause *= 2
        found.timer = self._timers.at(now + found.pause, lambda at: self._again(key, at))
        self._send(found.data, key[0])


class OscoreContext(oscore.CanProtect, oscore.CanUnprotect, oscore.SecurityContextUtils):  # type: ignore[misc]
    """One context, made of aiocoap's protection; `id_context`: if several are derived from one secret."""

    # Not None: then what is repeated is decrypted before it is refused, as what is forged is. The
    # window is always initialized, so nothing is compared with it.
    echo_recovery = b"unused"

    def __init__(
        self, secret: bytes, salt: bytes, sender: bytes, recipient: bytes, id_context: bytes | None = None
    ) -> None:
        if sender == recipient:
            raise DatagramRefused("both sides of a context have the same ID")
        if max(len(sender), len(recipient)) > MAX_ID:
            raise DatagramRefused("an ID that does not fit into a nonce")
        self.alg_aead = _ALGORITHM
        self.hashfun = _HASH
        self.sender_id, self.recipient_id = sender, recipient
        self.id_context = id_context
        self.derive_keys(salt, secret)
        self.sender_sequence_number = 0
        self.recipient_replay_window = oscore.ReplayWindow(WINDOW, lambda: None)
        self.recipient_replay_window.initialize_empty()

    def post_seqnoincrease(self) -> None:
        """Nothing: a sequence number is of this process only."""

    def seal(self, message: Message, request: RequestId = None) -> tuple[Message, RequestId]:
        sealed, identifier = self.protect(message, request, kid_context=False)
        return sealed, identifier

    def open(self, message: Message, request: RequestId = None) -> tuple[Message, RequestId]:
        try:
            # Without the kid context: whoever calls has chosen the context by it.
            option: bytes = message.opt.oscore or b""
            if option and option[0] & _H:
                at = 1 + (option[0] & 0x07)
                end = at + 1 + option[at]
                if end > len(option):
                    raise DatagramRefused("a kid context that ends early")
                message.opt.oscore = bytes((option[0] & ~_H,)) + option[1:at] + option[end:]
            opened, identifier = self.unprotect(message, request)
        except Exception as error:  # noqa: BLE001 - its errors have no common base
            raise DatagramRefused(f"not protected by this key: {type(error).__name__}") from None
        return opened, identifier


def unprotected(message: Message) -> tuple[bytes, bytes | None]:
    try:
        _, _, found, _ = oscore.CanUnprotect._extract_encrypted0(message)  # noqa: SLF001
    except Exception as error:  # noqa: BLE001 - as above
        raise DatagramRefused(f"not protected: {type(error).__name__}") from None
    kid = found.get(oscore.COSE_KID)
    if not isinstance(kid, bytes):
        raise DatagramRefused("a protected request without a kid")
    return kid, found.get(oscore.COSE_KID_CONTEXT)


def partial_iv(message: Message) -> int:
    """The sequence number that a verified answer has; -1: none, so that of its request."""
    option: bytes = message.opt.oscore or b"\0"
    size = option[0] & 0x07
    return int.from_bytes(option[1 : 1 + size]) if size else -1


def name_context(message: Message, kid_context: bytes) -> None:
    """Add a kid context to the option of a sealed message, which no tag covers."""
    # RFC 8613 section 6.1. aiocoap writes one in requests only, and that of the derivation itself; appendix
    # B.2 needs others, and one in an answer.
    option: bytes = message.opt.oscore or b"\0"
    size = option[0] & 0x07
    flags = bytes((option[0] | _H,))
    length = bytes((len(kid_context),))
    message.opt.oscore = flags + option[1 : 1 + size] + length + kid_context + option[1 + size :]


def wrapped(value: bytes) -> bytes:
    return encode(value)


def unwrapped(kid_context: bytes) -> bytes:
    try:
        value = decode(kid_context, limit=MAX_ID1 + 2)
    except EncodingError as error:
        raise DatagramRefused(f"a kid context that is no byte string: {error}") from None
    if not isinstance(value, bytes) or not NONCE_SIZE <= len(value) <= MAX_ID1:
        raise DatagramRefused("a kid context of another length")
    return value


def is_in(context: OscoreContext, kid_context: bytes | None) -> bool:
    """Whether a request that names this context (None: none) may be in it."""
    if kid_context is None:
        return True
    return context.id_context is not None and wrapped(context.id_context) == kid_context


@dataclass(frozen=True)
class ContextChallenges:
    """Makes and recognizes R2, for contexts of a thing with a secret of its own (RFC 8613 Appendix B.2).

    Neither side writes sequence numbers to a disk. After a restart of either, both contribute a random
    value to a new context: ID1 by the thing, R2 by the border router, R3 by the thing.
    """

    key: bytes  # 16 random octets of this process
    _answered: dict[bytes, int] = field(default_factory=dict)  # by kids that proved their secret

    def make(self, kid: bytes, now: float, random: bytes) -> bytes:
        # It shows itself to be of this process and recent, so an attempt costs no memory.
        head = int(now * 1000).to_bytes(_TIME) + random
        return head + self._tag(kid, head)

    def issued(self, kid: bytes, value: bytes, now: float) -> int:
        # When the R2 that `value` begins with was made, milliseconds; 0: not here, or long ago.
        head, tag = value[: R2_SIZE // 2], value[R2_SIZE // 2 : R2_SIZE]
        if not hmac.compare_digest(tag, self._tag(kid, head)):
            return 0
        made = int.from_bytes(head[:_TIME])
        return made if int(now * 1000) - made <= LIFETIME else 0

    def take(self, kid: bytes, value: bytes, now: float) -> bool:
        if len(value) != R2_SIZE + NONCE_SIZE:
            return False
        # Newer than any that the thing has answered, also when the former context was dropped: who repeats
        # recorded requests changes nothing, and no context begins a second time with its nonces.
        issued = self.issued(kid, value, now)
        if issued <= self._answered.get(kid, 0):
            return False
        self._answered[kid] = issued
        return True

    def _tag(self, kid: bytes, head: bytes) -> bytes:
        return hmac.digest(self.key, bytes((len(kid),)) + kid + head, "sha256")[: R2_SIZE // 2]


def border_context(secret: bytes, kid: bytes, id_context: bytes) -> OscoreContext:
    return OscoreContext(secret, _SALT, BORDER_ID, kid, id_context)


def thing_context(secret: bytes, kid: bytes, id_context: bytes) -> OscoreContext:
    return OscoreContext(secret, _SALT, kid, BORDER_ID, id_context)
