"""OSCORE contexts of things (RFC 8613), made of aiocoap's protection; one role or the other.

A context seals requests and answers in both directions: a thing registers by a request, and the
border router's requests to the thing use the same context with the same kid. A context lives in
memory only. After a restart there is none, and a new one is derived from fresh random values, so no
sequence number is ever used twice.
"""

from typing import Any, Final

from aiocoap import oscore

from rossec.border.wire import Message
from rossec.errors import DatagramRefused

WINDOW: Final = 32
SALT_SIZE: Final = 8
KEY_SIZE: Final = 16
MAX_ID: Final = 7  # octets of an ID: 6 less than a nonce has (RFC 8613 section 3.3)
_ALGORITHM: Final = oscore.algorithms["AES-CCM-16-64-128"]
_HASH: Final = oscore.hashfunctions["sha256"]
_H: Final = 0x10  # flag: there is a kid context

RequestId = Any


def _nothing() -> None:
    """Nothing is written when the window moves."""


class OscoreContext(oscore.CanProtect, oscore.CanUnprotect, oscore.SecurityContextUtils):  # type: ignore[misc]
    """One context.

    Args:
        secret: the master secret.
        salt: the master salt.
        sender: the ID of this side.
        recipient: the ID of the other side; another one.
        id_context: of contexts that are derived several times from one secret.

    Raises:
        DatagramRefused: both sides have the same ID, or one of them is too long.
    """

    echo_recovery = b"unused"
    """Not None: then what is repeated is decrypted before it is refused, as what is forged is. The
    window is always initialized, so nothing is compared with it."""

    def __init__(
        self,
        secret: bytes,
        salt: bytes,
        sender: bytes,
        recipient: bytes,
        id_context: bytes | None = None,
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
        self.recipient_replay_window = oscore.ReplayWindow(WINDOW, _nothing)
        self.recipient_replay_window.initialize_empty()

    def post_seqnoincrease(self) -> None:
        """Nothing: a sequence number is of this process only."""

    def seal(self, message: Message, request: RequestId = None) -> tuple[Message, RequestId]:
        """Protect a request, or the answer to `request`; returns it with the ID of the request."""
        sealed, identifier = self.protect(message, request, kid_context=False)
        return sealed, identifier

    def open(self, message: Message, request: RequestId = None) -> tuple[Message, RequestId]:
        """Verify and decrypt a request, or the answer to `request`.

        Raises:
            DatagramRefused: forged, repeated, or malformed.
        """
        try:
            _strip_context(message)  # whoever calls has chosen the context by it
            opened, identifier = self.unprotect(message, request)
        except Exception as error:  # noqa: BLE001 - its errors have no common base
            raise DatagramRefused(f"not protected by this key: {type(error).__name__}") from None
        return opened, identifier


def unprotected(message: Message) -> tuple[bytes, bytes | None]:
    """The kid and the kid context that a protected request names.

    Raises:
        DatagramRefused: not a protected request, or a malformed option.
    """
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
    """Add a kid context to the option of a sealed message, which no tag covers.

    aiocoap writes one in requests only, and that of the derivation itself; Appendix B.2 needs
    others, and one in an answer.
    """
    option: bytes = message.opt.oscore or b"\0"
    size = option[0] & 0x07
    flags = bytes((option[0] | _H,))
    length = bytes((len(kid_context),))
    message.opt.oscore = flags + option[1 : 1 + size] + length + kid_context + option[1 + size :]


def _strip_context(message: Message) -> None:
    """Remove the kid context of a message: aiocoap compares it with that of the derivation."""
    option: bytes = message.opt.oscore or b""
    if not option or not option[0] & _H:
        return
    at = 1 + (option[0] & 0x07)
    end = at + 1 + option[at]
    if end > len(option):
        raise DatagramRefused("a kid context that ends early")
    message.opt.oscore = bytes((option[0] & ~_H,)) + option[1:at] + option[end:]
