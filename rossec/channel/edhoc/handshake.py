"""EDHOC method 0 (RFC 9528 section 5): two signatures, both sides of it. Sections below are of that RFC.

One object per attempt, without input/output, clock or random source of its own: messages in, messages out.
Every check raises, and a caller that catches the error must end the session. Cheap checks (structure,
method, suite, lengths) come before key generation. Hashes and MACs are over the bytes on the wire.
message_4 is always sent: it confirms the key to an initiator, and after it errors are refused.
"""

from dataclasses import dataclass
from typing import Final, Generic, NamedTuple

from cryptography.exceptions import InvalidTag

from ca.encoding import Value, encode
from ca.errors import ForeignCertificate, HintedError
from rossec.channel.edhoc import credentials, messages
from rossec.channel.edhoc.credentials import PeerT
from rossec.channel.edhoc.suites import (
    GONE,
    HASH_LENGTH,
    OFFERED_SUITES,
    SIGNATURE_LENGTH,
    SUITES,
    Aead,
    EdhocExporter,
    Finish,
    KdfLabel,
    Random,
    Secret,
    bstr,
    extract,
    kdf,
    transcript_2,
    transcript_next,
)
from rossec.errors import ForeignIdentity, HandshakeFailed, IdentityRefused

METHOD: Final = 0
# Correlation is TCP's; the identifiers only have to be there (RFC 9528 section 3.3).
C_I: Final = b"\x00"
C_I_X5T: Final = b"\x01"  # "I may know your certificate: name it by its hash" (spec section 4)
C_R: Final = b"\x01"
# The beginnings of Sig_structure and Enc_structure (RFC 9052 sections 4.4 and 5.3).
_SIGNATURE1: Final = b"\x84" + encode("Signature1")
_ENCRYPT0: Final = b"\x83" + encode("Encrypt0") + encode(b"")
_HINT_REFLECTED: Final = "another process has this identity, or something redirects connections"
_HINT_ADDRESS: Final = "do two hosts go by one address? see ROS_IP and ROS_HOSTNAME"


class WrongSuite(HandshakeFailed):
    """The selected suite is not the right one; `suites` is SUITES_R."""

    def __init__(self, suites: tuple[int, ...]) -> None:
        super().__init__("the peer selected a cipher suite this node does not use")
        self.suites = suites


@dataclass(frozen=True)
class EdhocConfig(Generic[PeerT]):
    """One side's inputs: its credential, whom it trusts, its random source, its policy."""

    credential: credentials.OwnCredential
    verify: credentials.Verify[PeerT]
    random: Random
    suites: tuple[int, ...] = OFFERED_SUITES
    find_chain: credentials.FindChain = credentials.x5chain
    known: credentials.KnownCertificates | None = None  # with it, certificates may be named by x5t
    self_connections: credentials.SelfConnections | None = None  # with it, an initiator means itself
    request_x5t: bool = False  # an initiator's: ask the responder for an x5t
    ead: bytes = b""
    renews: credentials.Renews[PeerT] | None = None  # with it, this side takes renewals, and says so
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
        # Sections 5.3.2 and 5.4.2: MAC_x over context_x, then Sig_structure with MAC_x as its payload.
        external = bstr(self.th) + self.cred + self.ead
        mac = kdf(prk, self.label, self.prefix + self.id_cred + external, HASH_LENGTH)
        return _SIGNATURE1 + bstr(self.id_cred) + bstr(external) + bstr(mac)


class EdhocPeer(Generic[PeerT]):
    def __init__(self, config: EdhocConfig[PeerT]) -> None:
        self.config = config
        self.suite = SUITES[config.suites[0]]
        self._prk = GONE  # PRK_2e = PRK_3e2m = PRK_4e3m (section 4.1.1, with two signatures)
        self._th = b""  # TH_2, then TH_3, then TH_4
        self._exporter: EdhocExporter | None = None
        self._chain: tuple[bytes, ...] = ()
        self._peer_sent_x5t = False  # how the peer named its certificate
        self._g_x = self._g_y = b""
        self._dial: credentials.Dial | None = None  # set: an initiator that means to reach itself
        self.send_x5t = False  # this side names its certificate by a hash
        self.sent = b""  # the certificate of this side's statement
        self.peer_renews = False  # it takes what is renewed while the connection is open

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
        self._prk = extract(self._th, shared)  # section 4.1.1.1

    def _state(self, label: KdfLabel, c_r: bytes | None) -> bytes:
        # The plaintext of message_2 or message_3 (sections 5.3.2 and 5.4.2).
        config, own = self.config, self.config.credential.current
        # 1. ID_CRED_x, CRED_x, EAD_x.
        self.sent = own.certificate
        cred = bstr(self.sent)
        named = credentials.reference(self.sent) if self.send_x5t else own.id_cred
        ead = config.ead if config.renews is None else messages.RENEWALS_EAD
        # 2. MAC_x, and the signature over it.
        prefix = b"" if c_r is None else messages.encode_identifier(c_r)
        statement = _Statement(label, prefix, credentials.encode_id_cred(named), self._th, cred, ead)
        signature = own.signer.sign(statement.to_be_signed(self._prk))
        # 3. PLAINTEXT_x; the next transcript hash is over it, not over its ciphertext.
        plaintext = messages.Plaintext(c_r, named, signature, ead).encode()
        self._th = transcript_next(self._th, plaintext, cred)
        return plaintext

    def _check(self, label: KdfLabel, plaintext: bytes, now: int) -> PeerT:
        # Sections 5.3.3 and 5.4.3, from the decrypted plaintext on.
        # 1. Decode it.
        parsed = messages.decode_plaintext(plaintext, with_c_r=label is KdfLabel.MAC_2)
        # 2. From ID_CRED_x to CRED_x and the authentication key, by the application's policy.
        certificate, peer = self._identify(parsed.id_cred, now)
        # 3. Verify Signature_or_MAC_x.
        prefix = b"" if parsed.c_r is None else messages.encode_identifier(parsed.c_r)
        id_cred, cred = credentials.encode_id_cred(parsed.id_cred), bstr(certificate)
        statement = _Statement(label, prefix, id_cred, self._th, cred, parsed.ead)
        self.suite.verify(peer.public_key, parsed.signature, statement.to_be_signed(self._prk))
        # 4. EAD_x, and the next transcript hash.
        self.peer_renews = messages.says_renewals(parsed.ead)
        self._th = transcript_next(self._th, plaintext, cred)
        return peer

    def _identify(self, id_cred: Value, now: int) -> tuple[bytes, PeerT]:
        known = self.config.known
        chain = self.config.find_chain(id_cred) if known is None else known.find(id_cred)
        self._chain = chain
        self._peer_sent_x5t = known is not None and id_cred == credentials.reference(chain[0])
        try:
            peer = self.config.verify(chain, now)
        except HintedError as error:
            text = f"the peer's certificate is refused: {error}"
            kind = ForeignIdentity if isinstance(error, ForeignCertificate) else IdentityRefused
            raise kind(text, error.hint) from error
        # The key is compared: a renewed certificate has the same.
        own, dials = self.config.credential.current, self.config.self_connections
        is_own_key = peer.public_key == own.signer.public_key
        is_itself = is_own_key and dials is not None and dials.is_own(self._g_x, self._g_y)
        if is_own_key and not (is_itself or own.shared):
            raise IdentityRefused("the peer sent this node's own certificate", _HINT_REFLECTED)
        if self._dial is not None and not is_itself:
            raise IdentityRefused("another node answers at this node's own address", _HINT_ADDRESS)
        return chain[0], peer

    def _encrypt0(self, key: KdfLabel, iv: KdfLabel) -> tuple[Aead, bytes, bytes]:
        # K_x, IV_x and A_x of message_3 or message_4, under TH_3 or TH_4 (sections 5.4.2 and 5.5.2).
        suite = self.suite
        aead = suite.aead(kdf(self._prk, key, self._th, suite.key_length))
        return aead, kdf(self._prk, iv, self._th, suite.nonce_length), _ENCRYPT0 + bstr(self._th)

    def _open(self, key: KdfLabel, iv: KdfLabel, message: bytes) -> bytes:
        ciphertext = messages.decode_bytes(message)
        aead, nonce, associated = self._encrypt0(key, iv)
        try:
            return aead.decrypt(nonce, ciphertext, associated)
        except InvalidTag:
            raise HandshakeFailed("a handshake message does not decrypt") from None

    def _finish(self) -> None:
        self._exporter = EdhocExporter.derive(self._prk, self._th)  # PRK_out (section 4.1.3)
        if self.config.known is not None:
            self.config.known.remember(self._chain)


class Initiator(EdhocPeer[PeerT]):
    """Sends message_1, checks message_2, sends message_3, checks message_4."""

    def __init__(self, config: EdhocConfig[PeerT], selected: int | None = None) -> None:
        super().__init__(config)
        # Composition of message_1 (section 5.2.2).
        # 1. SUITES_I: the list keeps its order up to the selected one, as the responder checks it
        #    against a downgrade.
        number = config.suites[0] if selected is None else selected
        suites = config.suites[: config.suites.index(number) + 1]
        self.suite = SUITES[number]
        # 2. An ephemeral key, and G_X.
        self._finish_exchange: Finish | None
        self._finish_exchange, self._g_x = self.suite.exchange.start(config.random)
        if config.self_connections is not None:
            self._dial = config.self_connections.begin(self._g_x)
        # 3. C_I; then METHOD, SUITES_I, G_X, C_I, and no EAD_1.
        c_i = C_I_X5T if config.request_x5t else config.c_i
        self._message_1 = messages.Message1(METHOD, suites, self._g_x, c_i).encode()

    def make_message_1(self) -> bytes:
        return self._message_1

    @property
    def answered(self) -> bool:
        return self._exporter is not None

    def after_wrong_suite(self, offered: tuple[int, ...]) -> "Initiator[PeerT]":
        """Return a new attempt, with a new key, for SUITES_R of error 2 (section 6.3)."""
        usable = [number for number in self.config.suites if number in offered]
        if not usable or usable[0] == self.suite.number:
            raise HandshakeFailed("no cipher suite in common with the peer")
        return Initiator(self.config, usable[0])

    def on_message_2(self, data: bytes, now: int) -> tuple[bytes, PeerT]:
        # Processing of message_2 (section 5.3.3).
        # 1. Decode G_Y_CIPHERTEXT_2.
        body = messages.decode_bytes(data)
        exchange = self.suite.exchange
        g_y, ciphertext = body[: exchange.responder_length], body[exchange.responder_length :]
        if not SIGNATURE_LENGTH < len(ciphertext) <= messages.MAX_PLAINTEXT_2:
            raise HandshakeFailed("message_2 of a wrong length")
        if g_y == self._g_x:
            raise HandshakeFailed("the peer reflects this node's ephemeral key")
        # 2. The state: this is the first answer to this message_1.
        if self._finish_exchange is None:
            raise HandshakeFailed("a second message_2")
        shared, self._finish_exchange = self._finish_exchange(g_y), None
        self._g_y = g_y
        # 3. TH_2, PRK_2e, and with KEYSTREAM_2 the plaintext.
        self._agree(shared, g_y, self._message_1)
        plaintext = _xor(ciphertext, kdf(self._prk, KdfLabel.KEYSTREAM_2, self._th, len(ciphertext)))
        # 4. Who the responder is, and its signature.
        peer = self._check(KdfLabel.MAC_2, plaintext, now)
        # A responder that sent its whole certificate may not cache this side's either.
        known = self.config.known
        introduced = known is not None and self._chain[0] in known.introduced
        self.send_x5t = introduced and self._peer_sent_x5t
        # Composition of message_3 (section 5.4.2): K_3 and IV_3 are of TH_3, the statement moves to TH_4.
        aead, nonce, associated = self._encrypt0(KdfLabel.K_3, KdfLabel.IV_3)
        message_3 = bstr(aead.encrypt(nonce, self._state(KdfLabel.MAC_3, None), associated))
        self._finish()
        return message_3, peer

    def on_message_4(self, data: bytes) -> None:
        """Check message_4: the responder holds the same key (section 5.5.3)."""
        messages.decode_plaintext_4(self._open(KdfLabel.K_4, KdfLabel.IV_4, data))
        self._prk = GONE
        if self.config.known is not None:
            self.config.known.introduced[self._chain[0]] = None


class Responder(EdhocPeer[PeerT]):
    def on_message_1(self, data: bytes) -> bytes:
        config = self.config
        # Processing of message_1 (section 5.2.3).
        # 1. Decode it.
        parsed = messages.decode_message_1(data)
        if parsed.method != METHOD:
            raise HandshakeFailed("the peer requires another method than 0")
        # 2. The selected suite, the last one, is supported here, and none before it is.
        offered = parsed.suites
        usable = [number for number in offered if number in config.suites]
        if not usable or usable[0] != offered[-1]:
            raise WrongSuite((usable[0],) if usable else config.suites)
        self.suite = SUITES[usable[0]]
        exchange = self.suite.exchange
        if len(parsed.g_x) != exchange.initiator_length:
            raise HandshakeFailed("ephemeral key of a wrong length")
        self.send_x5t = config.known is not None and parsed.c_i == C_I_X5T
        # Composition of message_2 (section 5.3.2).
        # 1. An ephemeral key, G_Y, and the shared secret.
        g_y, shared = exchange.answer(config.random, parsed.g_x)
        self._g_x, self._g_y = parsed.g_x, g_y
        if config.self_connections is not None:
            config.self_connections.answer(parsed.g_x, g_y)
        # 2. TH_2, PRK_2e.
        self._agree(shared, g_y, data)
        prk, th_2 = self._prk, self._th
        # 3. C_R, MAC_2, the signature: PLAINTEXT_2.
        plaintext = self._state(KdfLabel.MAC_2, config.c_r)
        if len(plaintext) > messages.MAX_PLAINTEXT_2:
            raise HandshakeFailed(
                "this node's certificate chain is too long for the handshake",
                "use a shorter chain: at most 8160 bytes fit",
            )
        # 4. CIPHERTEXT_2, and G_Y before it.
        return bstr(g_y + _xor(plaintext, kdf(prk, KdfLabel.KEYSTREAM_2, th_2, len(plaintext))))

    def on_message_3(self, data: bytes, now: int) -> tuple[bytes, PeerT]:
        """Check message_3; return message_4 and the authenticated initiator."""
        # Processing of message_3 (section 5.4.3): decrypt under TH_3, then as for message_2.
        plaintext = self._open(KdfLabel.K_3, KdfLabel.IV_3, data)
        peer = self._check(KdfLabel.MAC_3, plaintext, now)
        self._finish()
        # Composition of message_4 (section 5.5.2), under TH_4 and without EAD_4.
        aead, nonce, associated = self._encrypt0(KdfLabel.K_4, KdfLabel.IV_4)
        message_4 = bstr(aead.encrypt(nonce, b"", associated))
        self._prk = GONE
        return message_4, peer


def _xor(left: bytes, right: bytes) -> bytes:
    size = len(left)
    return (int.from_bytes(left) ^ int.from_bytes(right)).to_bytes(size)
