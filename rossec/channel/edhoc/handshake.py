"""What both sides of an EDHOC handshake share: statements signed and verified, the messages' AEAD.

A side keeps the running transcript hash and secret; `handshake` has the order of the steps. Hashes
and MACs are over the bytes on the wire. Every check raises.

EDHOC method 0 (RFC 9528 section 5): two signatures, both sides of it.

One object per attempt, no input/output, no clock, no random source: messages in, messages out.
Other methods are not implemented. Every check raises; a caller that catches the error must end the
session. Cheap checks (structure, method, suite, lengths) come before key generation. message_4 is
always sent: it confirms the key to an initiator, and after it errors are refused.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Generic, NamedTuple

from cryptography.exceptions import InvalidTag

from ca.encoding import Value, encode
from ca.errors import ForeignCertificate, HintedError
from rossec.channel.edhoc.credentials import (
    Dial,
    FindChain,
    KnownCertificates,
    OwnCredential,
    OwnDials,
    PeerT,
    Renews,
    Verify,
    encode_id_cred,
    reference,
    x5chain,
)
from rossec.channel.edhoc.messages import (
    MAX_PLAINTEXT_2,
    Message1,
    Plaintext,
    decode_bytes,
    decode_message_1,
    decode_plaintext,
    decode_plaintext_4,
    encode_identifier,
    says_renewals,
)
from rossec.channel.edhoc.suites import (
    GONE,
    HASH_LENGTH,
    PRODUCTION,
    SIGNATURE_LENGTH,
    SUITES,
    EdhocExporter,
    Finish,
    KdfLabel,
    Random,
    Secret,
    Suite,
    bstr,
    extract,
    kdf,
    keystream_2,
    transcript_2,
    transcript_next,
)
from rossec.errors import ForeignIdentity, HandshakeFailed, IdentityRefused

# Correlation is TCP's; the identifiers only have to be there (RFC 9528 section 3.3).
C_I: Final = b"\x00"
C_I_X5T: Final = b"\x01"  # "I may know your certificate: name it by its hash" (spec section 4)
C_R: Final = b"\x01"
# The beginnings of Sig_structure and Enc_structure (RFC 9052 sections 4.4 and 5.3).
_SIGNATURE1: Final = b"\x84" + encode("Signature1")
_ENCRYPT0: Final = b"\x83" + encode("Encrypt0") + encode(b"")
_HINT_REFLECTED: Final = "another process has this identity, or something redirects connections"
_HINT_ADDRESS: Final = "do two hosts go by one address? see ROS_IP and ROS_HOSTNAME"


@dataclass(frozen=True)
class EdhocConfig(Generic[PeerT]):
    """One side's inputs: its credential, whom it trusts, its random source, its policy."""

    credential: OwnCredential
    verify: Verify[PeerT]
    random: Random
    suites: tuple[int, ...] = PRODUCTION
    find_chain: FindChain = x5chain
    known: KnownCertificates | None = None  # with it, certificates may be named by x5t
    own_dials: OwnDials | None = None  # with it, an initiator means to reach this node itself
    request_x5t: bool = False  # an initiator's: ask the responder for an x5t
    ead: bytes = b""
    renews: Renews[PeerT] | None = None  # with it, this side takes renewed certificates
    c_i: bytes = C_I
    c_r: bytes = C_R


class _Statement(NamedTuple):
    label: KdfLabel
    prefix: bytes  # C_R in message_2, nothing in message_3
    id_cred: bytes
    th: bytes
    cred: bytes
    ead: bytes

    def to_be_signed(self, prk: Secret) -> bytes:
        external = bstr(self.th) + self.cred + self.ead
        mac = kdf(prk, self.label, self.prefix + self.id_cred + external, HASH_LENGTH)
        return _SIGNATURE1 + bstr(self.id_cred) + bstr(external) + bstr(mac)


class EdhocPeer(Generic[PeerT]):
    def __init__(self, config: EdhocConfig[PeerT]) -> None:
        self._config = config
        self._suite = SUITES[config.suites[0]]
        self._prk = GONE
        self._th = b""
        self._exporter: EdhocExporter | None = None
        self._chain: tuple[bytes, ...] = ()
        self._peer_sent_x5t = False  # how the peer named its certificate
        self._g_x = self._g_y = b""
        self._dial: Dial | None = None  # set: an initiator that means to reach itself
        self.send_x5t = False  # this side names its certificate by a hash
        self.sent = b""  # the certificate of this side's statement
        self.peer_renews = False  # it takes what is renewed while the connection is open

    @property
    def config(self) -> EdhocConfig[PeerT]:
        return self._config

    @property
    def suite(self) -> Suite:
        return self._suite

    @property
    def exporter(self) -> EdhocExporter:
        # The secret for the records, once there is one.
        if self._exporter is None:
            raise HandshakeFailed("the handshake is not finished")
        return self._exporter

    def forget(self) -> None:
        # Drop the secrets; Python cannot wipe them.
        self._prk = GONE
        self._exporter = None

    def _agree(self, shared: bytes, g_y: bytes, message_1: bytes) -> None:
        self._th = transcript_2(g_y, message_1)
        self._prk = extract(self._th, shared)

    def _state(self, label: KdfLabel, c_r: bytes | None) -> bytes:
        own = self._config.credential
        prefix = b"" if c_r is None else encode_identifier(c_r)
        self.sent = own.certificate
        cred, ead = bstr(self.sent), self._config.ead
        named = reference(self.sent) if self.send_x5t else own.id_cred
        id_cred = encode_id_cred(named)
        statement = _Statement(label, prefix, id_cred, self._th, cred, ead)
        signature = own.sign(statement.to_be_signed(self._prk))
        plaintext = Plaintext(c_r, named, signature, ead).encode()
        self._th = transcript_next(self._th, plaintext, cred)
        return plaintext

    def _check(self, label: KdfLabel, plaintext: bytes, now: int) -> PeerT:
        parsed = decode_plaintext(plaintext, with_c_r=label is KdfLabel.MAC_2)
        certificate, peer = self._identify(parsed.id_cred, now)
        prefix = b"" if parsed.c_r is None else encode_identifier(parsed.c_r)
        id_cred, cred = encode_id_cred(parsed.id_cred), bstr(certificate)
        statement = _Statement(label, prefix, id_cred, self._th, cred, parsed.ead)
        message = statement.to_be_signed(self._prk)
        self._suite.verify(peer.public_key, parsed.signature, message)
        self.peer_renews = says_renewals(parsed.ead)
        self._th = transcript_next(self._th, plaintext, cred)
        return peer

    def _identify(self, id_cred: Value, now: int) -> tuple[bytes, PeerT]:
        known = self._config.known
        chain = self._config.find_chain(id_cred) if known is None else known.find(id_cred)
        self._chain = chain
        self._peer_sent_x5t = known is not None and id_cred == reference(chain[0])
        try:
            peer = self._config.verify(chain, now)
        except HintedError as error:
            text = f"the peer's certificate is refused: {error}"
            kind = ForeignIdentity if isinstance(error, ForeignCertificate) else IdentityRefused
            raise kind(text, error.hint) from error
        # The key is compared: a renewed certificate has the same.
        own, dials = self._config.credential, self._config.own_dials
        is_own_key = peer.public_key == own.public_key
        is_itself = is_own_key and dials is not None and dials.is_own(self._g_x, self._g_y)
        if is_own_key and not (is_itself or own.shared):
            raise IdentityRefused("the peer sent this node's own certificate", _HINT_REFLECTED)
        if self._dial is not None and not is_itself:
            raise IdentityRefused("another node answers at this node's own address", _HINT_ADDRESS)
        return chain[0], peer

    def _seal(self, key: KdfLabel, iv: KdfLabel, plaintext: bytes) -> bytes:
        return bstr(self._aead(key, iv, lambda aead: aead.encrypt, plaintext))

    def _open(self, key: KdfLabel, iv: KdfLabel, ciphertext: bytes) -> bytes:
        try:
            return self._aead(key, iv, lambda aead: aead.decrypt, ciphertext)
        except InvalidTag:
            raise HandshakeFailed("a handshake message does not decrypt") from None

    def _aead(
        self, key: KdfLabel, iv: KdfLabel, operation: Callable[..., Callable[..., bytes]], data: bytes
    ) -> bytes:
        suite = self._suite
        aead = suite.aead(kdf(self._prk, key, self._th, suite.key_length))
        nonce = kdf(self._prk, iv, self._th, suite.nonce_length)
        # external_aad is TH_3 or TH_4
        return operation(aead)(nonce, data, _ENCRYPT0 + bstr(self._th))

    def _finish(self) -> None:
        self._exporter = EdhocExporter.derive(self._prk, self._th)
        if self._config.known is not None:
            self._config.known.remember(self._chain)


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
        return self._message_1

    @property
    def answered(self) -> bool:
        return self._exporter is not None

    def after_wrong_suite(self, offered: tuple[int, ...]) -> "Initiator[PeerT]":
        """Return a new attempt, with a new key, for SUITES_R of error 2."""
        usable = [number for number in self._config.suites if number in offered]
        if not usable or usable[0] == self._suite.number:
            raise HandshakeFailed("no cipher suite in common with the peer")
        return Initiator(self._config, usable[0])

    def message_2(self, data: bytes, now: int) -> tuple[bytes, PeerT]:
        """Check message_2; return message_3 and the authenticated responder."""
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
        """Check message_4: the responder holds the same key."""
        decode_plaintext_4(self._open(KdfLabel.K_4, KdfLabel.IV_4, decode_bytes(data)))
        self._prk = GONE
        if self._config.known is not None:
            self._config.known.introduce(self._chain[0])


class Responder(EdhocPeer[PeerT]):
    """Checks message_1, sends message_2, checks message_3, sends message_4."""

    def message_1(self, data: bytes) -> bytes:
        """Check message_1; return message_2."""
        parsed = decode_message_1(data)
        if parsed.method != METHOD:
            raise HandshakeFailed("the peer requires another method than 0")
        offered = parsed.suites
        usable = [number for number in offered if number in self._config.suites]
        if not usable or usable[0] != offered[-1]:
            raise WrongSuite((usable[0],) if usable else self._config.suites)
        suite = SUITES[usable[0]]
        if len(parsed.g_x) != suite.exchange.initiator_length:
            raise HandshakeFailed("ephemeral key of a wrong length")
        self._suite = suite
        self.send_x5t = self._config.known is not None and parsed.c_i == C_I_X5T
        g_y, shared = suite.exchange.answer(self._config.random, parsed.g_x)
        self._g_x, self._g_y = parsed.g_x, g_y
        if self._config.own_dials is not None:
            self._config.own_dials.answer(parsed.g_x, g_y)
        self._agree(shared, g_y, data)
        prk, th_2 = self._prk, self._th
        plaintext = self._state(KdfLabel.MAC_2, self._config.c_r)
        if len(plaintext) > MAX_PLAINTEXT_2:
            raise HandshakeFailed(
                "this node's certificate chain is too long for the handshake",
                "use a shorter chain: at most 8160 bytes fit",
            )
        return bstr(g_y + _xor(plaintext, keystream_2(prk, th_2, len(plaintext))))

    def message_3(self, data: bytes, now: int) -> tuple[bytes, PeerT]:
        """Check message_3; return message_4 and the authenticated initiator."""
        plaintext = self._open(KdfLabel.K_3, KdfLabel.IV_3, decode_bytes(data))
        peer = self._check(KdfLabel.MAC_3, plaintext, now)
        self._finish()
        message_4 = self._seal(KdfLabel.K_4, KdfLabel.IV_4, b"")
        self._prk = GONE
        return message_4, peer


def _xor(left: bytes, right: bytes) -> bytes:
    size = len(left)
    return (int.from_bytes(left) ^ int.from_bytes(right)).to_bytes(size)
