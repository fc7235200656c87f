"""What both sides of an EDHOC handshake share: statements signed and verified, the messages' AEAD.

A side keeps the running transcript hash and secret; `handshake` has the order of the steps. Hashes
and MACs are over the bytes on the wire. Every check raises.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Generic, NamedTuple

from cryptography.exceptions import InvalidTag

from ca.encoding import Value, encode
from ca.errors import ForeignCertificate, HintedError
from rossec.channel.edhoc.credentials import (
    FindChain,
    OwnCredential,
    PeerT,
    Renews,
    Verify,
    encode_id_cred,
    x5chain,
)
from rossec.channel.edhoc.keyschedule import (
    GONE,
    EdhocExporter,
    KdfLabel,
    Secret,
    bstr,
    extract,
    kdf,
    transcript_2,
    transcript_next,
)
from rossec.channel.edhoc.known import KnownCertificates, reference
from rossec.channel.edhoc.messages import (
    Plaintext,
    decode_plaintext,
    encode_identifier,
    says_renewals,
)
from rossec.channel.edhoc.own_dials import Dial, OwnDials
from rossec.channel.edhoc.suites import HASH_LENGTH, PRODUCTION, SUITES, Random, Suite
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
    """What one side claims in message_2 or message_3, in the form that is MACed and signed."""

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
    """What both sides share: own statement, peer's statement, the AEAD of messages 3 and 4."""

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
        """This side's inputs."""
        return self._config

    @property
    def suite(self) -> Suite:
        """The suite both sides agreed on."""
        return self._suite

    @property
    def exporter(self) -> EdhocExporter:
        """The secret for the records, once there is one."""
        if self._exporter is None:
            raise HandshakeFailed("the handshake is not finished")
        return self._exporter

    def forget(self) -> None:
        """Drop the secrets; Python cannot wipe them."""
        self._prk = GONE
        self._exporter = None

    def _agree(self, shared: bytes, g_y: bytes, message_1: bytes) -> None:
        self._th = transcript_2(g_y, message_1)
        self._prk = extract(self._th, shared)

    def _state(self, label: KdfLabel, c_r: bytes | None) -> bytes:
        """Sign this side's statement, advance the transcript, return the plaintext."""
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
        """Verify the peer's statement, advance the transcript, return the peer."""
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
        self._check_meant(peer)
        return chain[0], peer

    def _check_meant(self, peer: PeerT) -> None:
        """Refuse this node where another one is expected, and another one where this node is.

        The key is compared: a renewed certificate has the same.
        """
        own, dials = self._config.credential, self._config.own_dials
        is_own_key = peer.public_key == own.public_key
        is_itself = is_own_key and dials is not None and dials.is_own(self._g_x, self._g_y)
        if is_own_key and not (is_itself or own.shared):
            raise IdentityRefused("the peer sent this node's own certificate", _HINT_REFLECTED)
        if self._dial is not None and not is_itself:
            raise IdentityRefused("another node answers at this node's own address", _HINT_ADDRESS)

    def _seal(self, key: KdfLabel, iv: KdfLabel, plaintext: bytes) -> bytes:
        return bstr(self._aead(key, iv, lambda aead: aead.encrypt, plaintext))

    def _open(self, key: KdfLabel, iv: KdfLabel, ciphertext: bytes) -> bytes:
        try:
            return self._aead(key, iv, lambda aead: aead.decrypt, ciphertext)
        except InvalidTag:
            raise HandshakeFailed("a handshake message does not decrypt") from None

    def _aead(
        self,
        key: KdfLabel,
        iv: KdfLabel,
        operation: Callable[..., Callable[..., bytes]],
        data: bytes,
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
