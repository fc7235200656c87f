"""EDHOC method 0 (RFC 9528 section 5): two signatures, both sides of it.

One object per attempt, no input/output, no clock, no dice: messages in, messages out. Method 3 and
the others do not exist here. Every check raises; a caller that catches one must end the session.
Cheap checks (structure, method, suite, lengths) come before key generation. message_4 is always
sent: it confirms the key to an initiator, and marks the point after which errors are refused.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Generic

from cryptography.exceptions import InvalidTag

from ca.encoding import Value, encode
from ca.errors import HintedError
from rossec.channel.credentials import FindChain, OwnCredential, PeerT, Verify, x5chain
from rossec.channel.keyschedule import (
    Exporter,
    Label,
    bstr,
    extract,
    kdf,
    keystream_2,
    transcript_2,
    transcript_next,
)
from rossec.channel.known import KnownCertificates, reference
from rossec.channel.messages import (
    MAX_PLAINTEXT_2,
    Message1,
    Plaintext,
    decode_bytes,
    decode_message_1,
    decode_plaintext,
    decode_plaintext_4,
    encode_identifier,
)
from rossec.channel.suites import (
    HASH_LENGTH,
    PRODUCTION,
    SIGNATURE_LENGTH,
    SUITES,
    Finish,
    Random,
    Suite,
)
from rossec.errors import HandshakeFailed, IdentityRefused

METHOD: Final = 0
# Correlation is TCP's; the identifiers only have to be there (RFC 9528 section 3.3).
C_I: Final = b"\x00"
C_I_BRIEF: Final = b"\x01"  # "I may know your certificate: name it by its hash" (spec section 4)
C_R: Final = b"\x01"
# The beginnings of Sig_structure and Enc_structure (RFC 9052 sections 4.4 and 5.3).
_SIGNATURE1: Final = b"\x84" + encode("Signature1")
_ENCRYPT0: Final = b"\x83" + encode("Encrypt0") + encode(b"")


class WrongSuite(HandshakeFailed):
    """The selected suite is not the right one; `suites` is SUITES_R."""

    def __init__(self, suites: tuple[int, ...]) -> None:
        super().__init__("the peer selected a cipher suite this node does not use")
        self.suites = suites


@dataclass(frozen=True)
class Party(Generic[PeerT]):
    """One side's inputs: its credential, whom it trusts, its dice, its policy."""

    credential: OwnCredential
    verify: Verify[PeerT]
    random: Random
    suites: tuple[int, ...] = PRODUCTION
    find_chain: FindChain = x5chain
    known: KnownCertificates | None = None  # with it, references to certificates are spoken
    brief: bool = False  # an initiator's: ask the responder for a reference
    ead: bytes = b""
    c_i: bytes = C_I
    c_r: bytes = C_R


@dataclass(frozen=True)
class _Statement:
    """What one side claims in message_2 or message_3, in the form that is MACed and signed."""

    label: Label
    prefix: bytes  # C_R in message_2, nothing in message_3
    id_cred: bytes
    th: bytes
    cred: bytes
    ead: bytes

    def to_be_signed(self, prk: bytes) -> bytes:
        external = bstr(self.th) + self.cred + self.ead
        mac = kdf(prk, self.label, self.prefix + self.id_cred + external, HASH_LENGTH)
        return _SIGNATURE1 + bstr(self.id_cred) + bstr(external) + bstr(mac)


class _Side(Generic[PeerT]):
    """What both sides share: own statement, peer's statement, the AEAD of messages 3 and 4."""

    def __init__(self, party: Party[PeerT]) -> None:
        self._party = party
        self._suite = SUITES[party.suites[0]]
        self._prk = b""
        self._th = b""
        self._exporter: Exporter | None = None
        self._chain: tuple[bytes, ...] = ()
        self.brief = False  # this side names its certificate by a hash

    @property
    def suite(self) -> Suite:
        """The suite both sides agreed on."""
        return self._suite

    @property
    def exporter(self) -> Exporter:
        """The secret for the records, once there is one."""
        if self._exporter is None:
            raise HandshakeFailed("the handshake is not finished")
        return self._exporter

    def forget(self) -> None:
        """Drop the secrets; Python cannot wipe them."""
        self._prk = b""
        self._exporter = None

    def _agree(self, shared: bytes, g_y: bytes, message_1: bytes) -> None:
        self._th = transcript_2(g_y, message_1)
        self._prk = extract(self._th, shared)

    def _state(self, label: Label, c_r: bytes | None) -> bytes:
        """Sign this side's statement, advance the transcript, return the plaintext."""
        own = self._party.credential
        prefix = b"" if c_r is None else encode_identifier(c_r)
        cred, ead = bstr(own.certificate), self._party.ead
        id_cred = reference(own.certificate) if self.brief else own.id_cred
        statement = _Statement(label, prefix, encode(id_cred), self._th, cred, ead)
        signature = own.sign(statement.to_be_signed(self._prk))
        plaintext = Plaintext(c_r, id_cred, signature, ead).encode()
        self._th = transcript_next(self._th, plaintext, cred)
        return plaintext

    def _check(self, label: Label, plaintext: bytes, now: int) -> PeerT:
        """Verify the peer's statement, advance the transcript, return who it is."""
        parsed = decode_plaintext(plaintext, with_c_r=label is Label.MAC_2)
        certificate, peer = self._identify(parsed.id_cred, now)
        prefix = b"" if parsed.c_r is None else encode_identifier(parsed.c_r)
        id_cred, cred = encode(parsed.id_cred), bstr(certificate)
        statement = _Statement(label, prefix, id_cred, self._th, cred, parsed.ead)
        message = statement.to_be_signed(self._prk)
        self._suite.verify(peer.public_key, parsed.signature, message)
        self._th = transcript_next(self._th, plaintext, cred)
        return peer

    def _identify(self, id_cred: Value, now: int) -> tuple[bytes, PeerT]:
        known = self._party.known
        chain = self._party.find_chain(id_cred) if known is None else known.find(id_cred)
        self._chain = chain
        if chain[0] == self._party.credential.certificate:
            # Reflection: nobody else can hold this certificate's key (notes: selfie attack).
            raise IdentityRefused("the peer shows this node's own certificate")
        try:
            return chain[0], self._party.verify(chain, now)
        except HintedError as error:
            text = f"the peer's certificate is refused: {error}"
            raise IdentityRefused(text, error.hint) from error

    def _seal(self, key: Label, iv: Label, plaintext: bytes) -> bytes:
        return bstr(self._aead(key, iv, lambda aead: aead.encrypt, plaintext))

    def _open(self, key: Label, iv: Label, ciphertext: bytes) -> bytes:
        try:
            return self._aead(key, iv, lambda aead: aead.decrypt, ciphertext)
        except InvalidTag:
            raise HandshakeFailed("a handshake message does not decrypt") from None

    def _aead(
        self, key: Label, iv: Label, operation: Callable[..., Callable[..., bytes]], data: bytes
    ) -> bytes:
        suite = self._suite
        aead = suite.aead(kdf(self._prk, key, self._th, suite.key_length))
        nonce = kdf(self._prk, iv, self._th, suite.nonce_length)
        # external_aad is TH_3 or TH_4
        return operation(aead)(nonce, data, _ENCRYPT0 + bstr(self._th))

    def _finish(self) -> None:
        self._exporter = Exporter.derive(self._prk, self._th)
        if self._party.known is not None:
            self._party.known.remember(self._chain)


class Initiator(_Side[PeerT]):
    """Sends message_1, checks message_2, sends message_3, checks message_4."""

    def __init__(self, party: Party[PeerT], selected: int | None = None) -> None:
        super().__init__(party)
        number = party.suites[0] if selected is None else selected
        self._suite = SUITES[number]
        self._finish_exchange: Finish | None
        self._finish_exchange, self._g_x = self._suite.exchange.start(party.random)
        # The list keeps its order up to the selected one: the responder checks against downgrade.
        suites = party.suites[: party.suites.index(number) + 1]
        c_i = C_I_BRIEF if party.brief else party.c_i
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
            HandshakeFailed: no common suite, or the peer refuses what it claims to support.
        """
        usable = [number for number in self._party.suites if number in offered]
        if not usable or usable[0] == self._suite.number:
            raise HandshakeFailed("no cipher suite in common with the peer")
        return Initiator(self._party, usable[0])

    def message_2(self, data: bytes, now: int) -> tuple[bytes, PeerT]:
        """Check message_2; return message_3 and the authenticated responder.

        Raises:
            HandshakeFailed: any flaw. `IdentityRefused` when only its certificate is at fault.
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
        self._agree(shared, g_y, self._message_1)
        plaintext = _xor(ciphertext, keystream_2(self._prk, self._th, len(ciphertext)))
        peer = self._check(Label.MAC_2, plaintext, now)
        known = self._party.known
        self.brief = known is not None and known.is_introduced(self._chain[0])
        return self._message_3(), peer

    def _message_3(self) -> bytes:
        th_3 = self._th
        plaintext = self._state(Label.MAC_3, None)
        th_4, self._th = self._th, th_3
        message = self._seal(Label.K_3, Label.IV_3, plaintext)
        self._th = th_4
        self._finish()
        return message

    def message_4(self, data: bytes) -> None:
        """Check message_4: the responder holds the same key.

        Raises:
            HandshakeFailed: it does not.
        """
        decode_plaintext_4(self._open(Label.K_4, Label.IV_4, decode_bytes(data)))
        self._prk = b""
        if self._party.known is not None:
            self._party.known.introduce(self._chain[0])


class Responder(_Side[PeerT]):
    """Checks message_1, sends message_2, checks message_3, sends message_4."""

    def message_1(self, data: bytes) -> bytes:
        """Check message_1; return message_2.

        Raises:
            WrongSuite: to be answered with error 2.
            HandshakeFailed: any other flaw.
        """
        parsed = decode_message_1(data)
        if parsed.method != METHOD:
            raise HandshakeFailed("the peer wants another method than 0")
        suite = self._select(parsed.suites)
        if len(parsed.g_x) != suite.exchange.initiator_length:
            raise HandshakeFailed("ephemeral key of a wrong length")
        self._suite = suite
        self.brief = self._party.known is not None and parsed.c_i == C_I_BRIEF
        g_y, shared = suite.exchange.answer(self._party.random, parsed.g_x)
        self._agree(shared, g_y, data)
        return self._message_2(g_y)

    def _select(self, offered: tuple[int, ...]) -> Suite:
        """The selected suite, if it is the first of the list that this side uses."""
        usable = [number for number in offered if number in self._party.suites]
        if not usable or usable[0] != offered[-1]:
            raise WrongSuite((usable[0],) if usable else self._party.suites)
        return SUITES[usable[0]]

    def _message_2(self, g_y: bytes) -> bytes:
        prk, th_2 = self._prk, self._th
        plaintext = self._state(Label.MAC_2, self._party.c_r)
        if len(plaintext) > MAX_PLAINTEXT_2:
            raise HandshakeFailed(
                "this node's certificate chain is too long for the handshake",
                "use a shorter chain: at most 8160 bytes fit",
            )
        return bstr(g_y + _xor(plaintext, keystream_2(prk, th_2, len(plaintext))))

    def message_3(self, data: bytes, now: int) -> tuple[bytes, PeerT]:
        """Check message_3; return message_4 and the authenticated initiator.

        Raises:
            HandshakeFailed: any flaw. `IdentityRefused` when only its certificate is at fault.
        """
        plaintext = self._open(Label.K_3, Label.IV_3, decode_bytes(data))
        peer = self._check(Label.MAC_3, plaintext, now)
        self._finish()
        message_4 = self._seal(Label.K_4, Label.IV_4, b"")
        self._prk = b""
        return message_4, peer


def _xor(left: bytes, right: bytes) -> bytes:
    size = len(left)
    return (int.from_bytes(left) ^ int.from_bytes(right)).to_bytes(size)
