"""A certificate named by its hash (x5t): a lookup key that an attacker chooses, and never trust.

The robot caches the certificates of its peers. Eve is enrolled and granted, and speaks
the protocol correctly except for the certificate she names.
"""

import dataclasses
import hashlib
from collections.abc import Callable
from typing import Final

import pytest

from ca.certificates import Identity
from ca.encoding import Value
from rossec.channel.edhoc import credentials as known
from rossec.channel.edhoc.credentials import Credentials, KnownCertificates, reference
from rossec.errors import HandshakeFailed, OwnCredentialUnknown, PeerRefused
from rossec.net.aio import SecureStream, connect, serve
from rossec.node import Node
from tests.support.attacker import EVE, HOST, credentials, fields_for, send_header
from tests.support.contexts import unlimited
from tests.support.site import Site
from tests.support.witness import TOPIC, Witness

pytestmark = pytest.mark.attack("x5t")
VIEWER: Final = "/viewer"


@dataclasses.dataclass(frozen=True)
class Named(Credentials):
    """Credentials that name any certificate."""

    named: Value = None

    @property
    def id_cred(self) -> Value:
        return self.named


def memory(node: Node) -> KnownCertificates:
    """The certificate cache of a node."""
    found = node._dialer._context.known
    assert found is not None
    return found


def digest(certificate: bytes) -> bytes:
    return hashlib.sha256(certificate).digest()


async def refused(witness: Witness, own: Credentials, named: Value, shown: bytes) -> PeerRefused:
    """How the robot answers a key under that name; `shown` is the certificate it signs."""
    forged = Named(own.signer, (shown,), named=named)
    with pytest.raises(PeerRefused) as caught:
        await send_header(witness.topic_port, forged, fields_for(VIEWER, TOPIC, None))
    await witness.goes_on()
    return caught.value


async def met(site: Site, witness: Witness, name: str) -> bytes:
    """The certificate of a node that the robot has cached."""
    own = site.enroll(name).credentials()
    stream = await connect(HOST, witness.topic_port, unlimited(own, site.anchor.verify))
    await stream.send(b"\0\0\0\0")
    await stream.wait_ended()
    assert memory(witness.robot).find(reference(own.certificate))[0] == own.certificate
    return own.certificate


WRONG: Final[dict[str, Callable[[bytes], Value]]] = {
    "truncated": lambda cert: {34: [-15, digest(cert)[:7]]},
    "one octet": lambda cert: {34: [-15, digest(cert)[:1]]},
    "empty": lambda _: {34: [-15, b""]},
    "too long": lambda cert: {34: [-15, digest(cert)[:9]]},
    "whole": lambda cert: {34: [-16, digest(cert)]},
    "of another algorithm": lambda cert: {34: [-16, digest(cert)[:8]]},
    "no list": lambda cert: {34: digest(cert)[:8]},
    "text": lambda cert: {34: [-15, digest(cert)[:8].hex()]},
    "beside a chain": lambda cert: {33: cert, 34: [-15, digest(cert)[:8]]},
}


@pytest.mark.parametrize("form", WRONG)
async def test_a_reference_in_another_form(site: Site, witness: Witness, form: str) -> None:
    own = credentials(site)
    shown = await met(site, witness, EVE)
    answer = await refused(witness, own, WRONG[form](shown), shown)
    assert str(answer).startswith("the peer refused the handshake")


async def test_an_unknown_hash(site: Site, witness: Witness) -> None:
    own = credentials(site)
    before = len(memory(witness.robot))
    others: list[Value] = [{34: [-15, bytes(8)]}, {34: [-15, b"\xff" * 8]}]
    for named in (reference(own.certificate), *others):
        answer = await refused(witness, own, named, own.certificate)
        assert isinstance(answer, OwnCredentialUnknown)
    assert len(memory(witness.robot)) == before


async def test_the_hash_of_another_node(site: Site, witness: Witness) -> None:
    """The robot finds the viewer's certificate, and Eve has no key for it."""
    viewers = await met(site, witness, VIEWER)
    own = credentials(site)
    for shown in (viewers, own.certificate):
        answer = await refused(witness, own, reference(viewers), shown)
        assert not isinstance(answer, OwnCredentialUnknown)
    assert memory(witness.robot).find(reference(viewers))[0] == viewers


async def test_a_certificate_without_its_key_is_not_cached(site: Site, witness: Witness) -> None:
    """Sent by value, and refused: the hash is still unknown."""
    own, other = credentials(site), site.enroll("/other").credentials()
    await refused(witness, own, other.id_cred, other.certificate)
    answer = await refused(witness, own, reference(other.certificate), other.certificate)
    assert isinstance(answer, OwnCredentialUnknown)


def colliding(site: Site) -> tuple[str, str]:
    """Two nodes of the site whose certificates have one hash."""
    seen: dict[bytes, str] = {}
    for number in range(300):
        name = f"/twin{number}"
        short = known._short(site.enroll(name).credentials().certificate)
        if short in seen:
            return seen[short], name
        seen[short] = name
    raise AssertionError("no two of 300 share one of 256 hashes")


async def test_two_certificates_of_one_hash(
    site: Site, witness: Witness, monkeypatch: pytest.MonkeyPatch
) -> None:
    """64 bits are too many to find two: so here a hash has 8. Neither is taken for the other."""
    monkeypatch.setattr(known, "_short", lambda cert: digest(cert)[:1] * 8)
    first, second = colliding(site)
    certificate = await met(site, witness, first)
    other = site.enroll(second).credentials()
    # While the robot knows the first alone, the second cannot be taken for it.
    answer = await refused(witness, other, reference(other.certificate), other.certificate)
    assert not isinstance(answer, OwnCredentialUnknown)
    # Once it knows both, the hash is ambiguous.
    stream = await connect(HOST, witness.topic_port, unlimited(other, site.anchor.verify))
    await stream.send(b"\0\0\0\0")
    await stream.wait_ended()
    for own in (site.enroll(first).credentials(), other):
        answer = await refused(witness, own, reference(certificate), own.certificate)
        assert isinstance(answer, OwnCredentialUnknown)


async def test_a_node_that_shares_its_hash_is_reached(
    site: Site, witness: Witness, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Refused because the robot found another certificate: it connects again, by value."""
    monkeypatch.setattr(known, "_short", lambda cert: digest(cert)[:1] * 8)
    first, second = colliding(site)
    own, remembered = site.enroll(second).credentials(), KnownCertificates()
    for _ in range(2):  # the second time both sides speak in hashes
        await reached(site, witness, own, remembered)
    memory(witness.robot)._chains.clear()  # as it does with 256 others
    await met(site, witness, first)
    await reached(site, witness, own, remembered)


async def reached(site: Site, witness: Witness, own: Credentials, remembered: KnownCertificates) -> None:
    stream = await connect(HOST, witness.topic_port, unlimited(own, site.anchor.verify, known=remembered))
    await stream.send(b"\0\0\0\0")
    await stream.wait_ended()


async def test_a_responder_that_names_the_certificate_of_another(site: Site, witness: Witness) -> None:
    """Eve answers at the robot's address with its certificate's hash, cached by her caller."""
    robot, eve = site.enroll("/robot").credentials(), credentials(site)
    own, remembered = site.enroll("/caller").credentials(), KnownCertificates()
    await reached(site, witness, own, remembered)
    forged = Named(eve.signer, robot.chain, named=reference(robot.certificate))
    called: list[str] = []

    async def never(stream: SecureStream[Identity]) -> None:
        called.append(stream.peer.name)

    verify = site.anchor.verify
    async with serve(never, HOST, 0, unlimited(forged, verify)) as server:
        remembered.addresses[HOST, server.port] = None
        with pytest.raises(HandshakeFailed, match="signature"):
            await connect(HOST, server.port, unlimited(own, verify, known=remembered))
    assert called == []
