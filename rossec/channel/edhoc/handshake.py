"""EDHOC method 0 (RFC 9528 section 5): two signatures, both sides of it.

One object per attempt, no input/output, no clock, no random source: messages in, messages out.
Other methods are not implemented. Every check raises; a caller that catches the error must end the
session. Cheap checks (structure, method, suite, lengths) come before key generation. message_4 is
always sent: it confirms the key to an initiator, and after it errors are refused.
"""

from typing import Final

from rossec.channel.edhoc.credentials import PeerT
from rossec.channel.edhoc.keyschedule import GONE, KdfLabel, bstr, keystream_2
from rossec.channel.edhoc.messages import (
    MAX_PLAINTEXT_2,
    Message1,
    decode_bytes,
    decode_message_1,
    decode_plaintext_4,
)
from rossec.channel.edhoc.peer import C_I_X5T, EdhocConfig, EdhocPeer
from rossec.channel.edhoc.suites import SIGNATURE_LENGTH, SUITES, Finish, Suite
from rossec.errors import HandshakeFailed

METHOD: Final = 0


class WrongSuite(HandshakeFailed):
    """The selected suite is not the right one; `suites` is SUITES_R."""

    def __init__(self, suites: tuple[int, ...]) -> None:
        super().__init__("the peer selected a cipher suite this node does not use")
        self.suites = suites


class Initiator(EdhocPeer[PeerT]):
    """Sends message_1, checks message_2, sends message_3, checks message_4."""

    def __init__(self, config: EdhocConfig[PeerT], selected: int | None = None) -> None:
        super().__init__(config)
        number = config.suites[0] if selected is None else selected
        self._suite = SUITES[number]
        self._finish_exchange: Finish | None
        self._finish_exchange, self._g_x = self._suite.exchange.start(config.random)
        if config.own_dials is not None:
            self._dial = config.own_dials.begin(self._g_x)
        # The list keeps its order up to the selected one: the responder checks against downgrade.
        suites = config.suites[: config.suites.index(number) + 1]
        c_i = C_I_X5T if config.request_x5t else config.c_i
        self._message_1 = Message1(METHOD, suites, self._g_x, c_i).encode()

    def message_1(self) -> bytes:
        """Return message_1; the same bytes every time."""
        return self._message_1

    @property
    def answered(self) -> bool:
        """Whether message_2 has been accepted; after it no retry makes sense."""
        return self._exporter is not None

    def after_wrong_suite(self, offered: tuple[int, ...]) -> "Initiator[PeerT]":
        """Return a new attempt, with a new key, for SUITES_R of error 2.

        Raises:
            HandshakeFailed: no common suite, or the peer refuses a suite that it lists.
        """
        usable = [number for number in self._config.suites if number in offered]
        if not usable or usable[0] == self._suite.number:
            raise HandshakeFailed("no cipher suite in common with the peer")
        return Initiator(self._config, usable[0])

    def message_2(self, data: bytes, now: int) -> tuple[bytes, PeerT]:
        """Check message_2; return message_3 and the authenticated responder.

        Raises:
            HandshakeFailed: any error; `IdentityRefused` when only its certificate is refused.
        """
        body = decode_bytes(data)
        exchange = self._suite.exchange
        g_y, ciphertext = body[: exchange.responder_length], body[exchange.responder_length :]
        if not SIGNATURE_LENGTH < len(ciphertext) <= MAX_PLAINTEXT_2:
            raise HandshakeFailed("message_2 of a wrong length")
        if g_y == self._g_x:
            raise HandshakeFailed("the peer reflects this node's ephemeral key")
        if self._finish_exchange is None:
            raise HandshakeFailed("a second message_2")
        shared, self._finish_exchange = self._finish_exchange(g_y), None
        self._g_y = g_y
        self._agree(shared, g_y, self._message_1)
        plaintext = _xor(ciphertext, keystream_2(self._prk, self._th, len(ciphertext)))
        peer = self._check(KdfLabel.MAC_2, plaintext, now)
        known = self._config.known
        # A responder that sent its whole certificate may not cache this side's either.
        introduced = known is not None and known.is_introduced(self._chain[0])
        self.send_x5t = introduced and self._peer_sent_x5t
        return self._message_3(), peer

    def _message_3(self) -> bytes:
        th_3 = self._th
        plaintext = self._state(KdfLabel.MAC_3, None)
        th_4, self._th = self._th, th_3
        message = self._seal(KdfLabel.K_3, KdfLabel.IV_3, plaintext)
        self._th = th_4
        self._finish()
        return message

    def message_4(self, data: bytes) -> None:
        """Check message_4: the responder holds the same key.

        Raises:
            HandshakeFailed: it does not.
        """
        decode_plaintext_4(self._open(KdfLabel.K_4, KdfLabel.IV_4, decode_bytes(data)))
        self._prk = GONE
        if self._config.known is not None:
            self._config.known.introduce(self._chain[0])


class Responder(EdhocPeer[PeerT]):
    """Checks message_1, sends message_2, checks message_3, sends message_4."""

    def message_1(self, data: bytes) -> bytes:
        """Check message_1; return message_2.

        Raises:
            WrongSuite: to be answered with error 2.
            HandshakeFailed: any other error.
        """
        parsed = decode_message_1(data)
        if parsed.method != METHOD:
            raise HandshakeFailed("the peer requires another method than 0")
        suite = self._select(parsed.suites)
        if len(parsed.g_x) != suite.exchange.initiator_length:
            raise HandshakeFailed("ephemeral key of a wrong length")
        self._suite = suite
        self.send_x5t = self._config.known is not None and parsed.c_i == C_I_X5T
        g_y, shared = suite.exchange.answer(self._config.random, parsed.g_x)
        self._g_x, self._g_y = parsed.g_x, g_y
        if self._config.own_dials is not None:
            self._config.own_dials.answer(parsed.g_x, g_y)
        self._agree(shared, g_y, data)
        return self._message_2(g_y)

    def _select(self, offered: tuple[int, ...]) -> Suite:
        """The selected suite, if it is the first of the list that this side uses."""
        usable = [number for number in offered if number in self._config.suites]
        if not usable or usable[0] != offered[-1]:
            raise WrongSuite((usable[0],) if usable else self._config.suites)
        return SUITES[usable[0]]

    def _message_2(self, g_y: bytes) -> bytes:
        prk, th_2 = self._prk, self._th
        plaintext = self._state(KdfLabel.MAC_2, self._config.c_r)
        if len(plaintext) > MAX_PLAINTEXT_2:
            raise HandshakeFailed(
                "this node's certificate chain is too long for the handshake",
                "use a shorter chain: at most 8160 bytes fit",
            )
        return bstr(g_y + _xor(plaintext, keystream_2(prk, th_2, len(plaintext))))

    def message_3(self, data: bytes, now: int) -> tuple[bytes, PeerT]:
        """Check message_3; return message_4 and the authenticated initiator.

        Raises:
            HandshakeFailed: any error; `IdentityRefused` when only its certificate is refused.
        """
        plaintext = self._open(KdfLabel.K_3, KdfLabel.IV_3, decode_bytes(data))
        peer = self._check(KdfLabel.MAC_3, plaintext, now)
        self._finish()
        message_4 = self._seal(KdfLabel.K_4, KdfLabel.IV_4, b"")
        self._prk = GONE
        return message_4, peer


def _xor(left: bytes, right: bytes) -> bytes:
    size = len(left)
    return (int.from_bytes(left) ^ int.from_bytes(right)).to_bytes(size)
