"""Mallory between a node and its authority, while the node is enrolled.

She owns the network: every message passes through her, and she runs an authority of her own. What
she does not own is the person who carries the code one way and six digits the other way.
"""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtensionOID

from ca.enrollment import qr, sides
from ca.enrollment.messages import (
    Acknowledgement,
    Delivery,
    Done,
    EnrollmentOffer,
    Message,
    frame,
    length,
    read,
    write,
)
from ca.enrollment.sides import AuthorityEnrollment, AuthorityState, NodeState
from ca.errors import ConflictingOffer, EnrollmentOver, EnrollmentRefused, RequestRefused, RequestSwapped
from rossec.enrollment import enroll
from tests.ca.test_requests import CA_TRUE, SAN, crafted
from tests.support.enrolling import Robot, WaitingRobot, clock, fresh
from tests.support.pki import Site, uris

HOME, MALLORY = Site.create(now=clock()), Site.create(now=clock())
Change = Callable[[Message], Message | None]


@asynccontextmanager
async def between(robot: WaitingRobot, change: Change) -> AsyncIterator[int]:
    """A port that is the robot's as far as the authority knows; `change` sees every message."""

    async def call(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        there, back = await asyncio.open_connection(robot._host, robot.port)
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(carry(reader, back, change))
                group.create_task(carry(there, writer, change))
        finally:
            writer.close()
            back.close()

    server = await asyncio.start_server(call, "127.0.0.1", 0)
    async with server:
        yield server.sockets[0].getsockname()[1]


async def carry(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, change: Change) -> None:
    try:
        while True:
            size = length(await reader.readexactly(4))
            changed = change(read(await reader.readexactly(size)))
            if changed is not None:
                writer.write(frame(write(changed)))
    except (EOFError, OSError):
        writer.close()


def scanned(robot: WaitingRobot) -> AuthorityEnrollment:
    return AuthorityEnrollment(qr.parse(robot.code), "home")


def offer_of(core: AuthorityEnrollment, site: Site = HOME) -> bytes:
    core.approve(clock())
    leaf = site.authority.issue(core.csr, now=clock(), serial=3)
    return core.offer([leaf], site.root, fresh(), clock())


async def enrolled_through(
    robot: WaitingRobot, change: Change, core: AuthorityEnrollment | None = None
) -> AuthorityEnrollment:
    core = core or scanned(robot)
    async with between(robot, change) as port:
        await enroll.fetch(core, "127.0.0.1", port, clock)
        made = offer_of(core)
        await enroll.deliver(core, made, "127.0.0.1", port, clock, lambda _: None)
    return core


def forged(csr: bytes, secret: bytes = b"") -> EnrollmentOffer:
    """An offer of Mallory's authority for the robot's own request."""
    leaf, nonce = MALLORY.authority.issue(csr, now=clock(), serial=3), fresh()
    agreed = sides.transcript(csr, [leaf], MALLORY.root, nonce)
    return EnrollmentOffer((leaf,), MALLORY.root, nonce, sides.tag(secret, agreed) if secret else b"")


def honest(message: Message) -> Message:
    return message


@pytest.mark.attack("read-network")
@pytest.mark.parametrize("label", [False, True])
async def test_a_passive_network_learns_nothing(label: bool) -> None:
    with WaitingRobot(Robot(), label=label) as robot:
        core = await enrolled_through(robot, honest)
    assert core.state is AuthorityState.ENROLLED
    assert [pending.root for pending in robot.trusted] == [HOME.root]


@pytest.mark.attack("enrollment-middle")
@pytest.mark.parametrize("label", [False, True])
async def test_a_swapped_request(label: bool) -> None:
    """The same name and a key of Mallory's: she would be the robot."""
    impostor = Robot()

    def swap(message: Message) -> Message:
        return Delivery(impostor.csr) if isinstance(message, Delivery) else message

    with WaitingRobot(Robot(), label=label) as robot, pytest.raises(RequestSwapped):
        await enrolled_through(robot, swap)
    assert robot.trusted == []


@pytest.mark.attack("enrollment-middle")
async def test_a_swapped_authority_without_the_code_is_refused() -> None:
    robot_ = Robot()

    def swap(message: Message) -> Message:
        return forged(robot_.csr, bytes(16)) if isinstance(message, EnrollmentOffer) else message

    with WaitingRobot(robot_) as robot:
        with pytest.raises(EnrollmentOver, match="the node refused the offer"):
            await enrolled_through(robot, swap)
        assert robot.core.state is NodeState.SHOWING
    assert robot.trusted == []
    assert "has not read the code" in robot.complaints[0]


@pytest.mark.attack("enrollment-middle")
async def test_a_swapped_authority_and_a_label() -> None:
    """The node answers Mallory; its answer covers her offer, and the authority detects that."""
    robot_ = Robot()

    def swap(message: Message) -> Message:
        return forged(robot_.csr) if isinstance(message, EnrollmentOffer) else message

    with (
        WaitingRobot(robot_, label=True, person=lambda _: None) as robot,
        pytest.raises(EnrollmentRefused, match="for another offer"),
    ):
        await enrolled_through(robot, swap)
    assert robot.trusted == []


@pytest.mark.attack("enrollment-middle")
async def test_a_swapped_authority_and_a_replayed_answer() -> None:
    """The literal form of step 4 would fail here: an earlier answer was stored."""
    robot_ = Robot()
    kept: list[Message] = []

    def keep(message: Message) -> Message:
        if isinstance(message, Acknowledgement | Done):
            kept.append(message)
        return message

    with WaitingRobot(robot_, label=True) as robot:
        await enrolled_through(robot, keep)
    assert [type(message) for message in kept] == [Acknowledgement, Done]

    def swap(message: Message) -> Message:
        if isinstance(message, EnrollmentOffer):
            return forged(robot_.csr)
        return kept[0] if isinstance(message, Acknowledgement) else message

    with (
        WaitingRobot(robot_, label=True, person=lambda _: None) as robot,
        pytest.raises(EnrollmentRefused, match="for another offer"),
    ):
        await enrolled_through(robot, swap)
    assert robot.trusted == []


@pytest.mark.attack("enrollment-middle")
async def test_a_delayed_answer_and_a_chosen_offer() -> None:
    """Label codes are public: Mallory gets the node's answer to the true offer, ends that session,
    and makes the node an offer of her own before she passes the answer on. With digits that depend
    on the offer alone, a million nonces would make hers fit.
    """
    robot = Robot()
    first, second = (robot.enrollment(label=True, now=clock()) for _ in range(2))
    core = AuthorityEnrollment(qr.parse(first.code()), "home")
    core.receive(write(Delivery(robot.csr)), clock())
    made = offer_of(core)
    (answer,) = first.receive(made, clock())
    with pytest.raises(ConflictingOffer):
        first.receive(write(forged(robot.csr)), clock())
    core.receive(answer, clock())
    second.receive(write(forged(robot.csr)), clock())
    assert core.digits != second.pending.digits  # but for one time in a million
    with pytest.raises(ConflictingOffer):  # nor may she try again
        second.receive(write(forged(robot.csr)), clock())
    assert second.state is NodeState.OVER


@pytest.mark.attack("enrollment-code")
@pytest.mark.parametrize("site", [HOME, MALLORY], ids=["then the owner", "then another thief"])
async def test_a_stolen_screen_code_used_first(site: Site) -> None:
    """A camera saw the screen. The owner's offer ends the attacker's session and is reported.

    If the thief also keeps the owner out, the owner's side never shows digits: nothing to confirm.
    """
    robot_ = Robot()
    with WaitingRobot(robot_, person=lambda _: None) as robot:
        secret = qr.parse(robot.code).secret
        reader, writer = await asyncio.open_connection(robot._host, robot.port)
        writer.write(frame(write(forged(robot_.csr, secret))))
        assert length(await reader.readexactly(4)) > 0  # the node has answered the thief
        core = scanned(robot)
        await enroll.fetch(core, robot._host, robot.port, clock)
        with pytest.raises(ConflictingOffer, match="another party has its code"):
            await enroll.deliver(core, offer_of(core, site), robot._host, robot.port, clock, pytest.fail)
        writer.close()
        assert robot.core.state is NodeState.OVER
    assert core.digits == ""
    assert robot.trusted == []


@pytest.mark.attack("enrollment-code")
async def test_a_code_used_twice() -> None:
    with WaitingRobot(Robot()) as robot:
        core = scanned(robot)
        await enroll.fetch(core, robot._host, robot.port, clock)
        second = scanned(robot)
        await enroll.fetch(second, robot._host, robot.port, clock)
        await enroll.deliver(core, offer_of(core), robot._host, robot.port, clock, lambda _: None)
        with pytest.raises(EnrollmentRefused, match="enrolled already"):
            robot.core.receive(offer_of(second), clock())
    assert len(robot.trusted) == 1


# --- requests no node of ours would make


def raw_name(uri: bytes) -> tuple[x509.ExtensionType, bool]:
    """A subject alternative name with one URI of any octets."""
    name = b"\x86" + bytes([len(uri)]) + uri
    value = b"\x30" + bytes([len(name)]) + name
    return x509.UnrecognizedExtension(ExtensionOID.SUBJECT_ALTERNATIVE_NAME, value), True


def long_name() -> bytes:
    return crafted((uris("spiffe://home/" + "a" * 255), True))


def unproven() -> bytes:
    csr = bytearray(crafted((SAN, True)))
    csr[-1] ^= 1
    return bytes(csr)


def rsa_request() -> bytes:
    builder = x509.CertificateSigningRequestBuilder(x509.Name([])).add_extension(SAN, critical=True)
    key = rsa.generate_private_key(65537, 2048)
    return builder.sign(key, SHA256()).public_bytes(Encoding.DER)


DNS_WILDCARD = x509.SubjectAlternativeName([x509.DNSName("*.home")])
BOTH = x509.SubjectAlternativeName([x509.UniformResourceIdentifier("spiffe://home/a"), x509.DNSName("a")])
P384 = ec.generate_private_key(ec.SECP384R1())
BIDI = raw_name("spiffe://home/a\u202eb".encode())
HOSTILE = {
    "CA:TRUE": (crafted((SAN, True), (CA_TRUE, True)), "asks to be an authority"),
    "two names": (crafted((BOTH, True)), "asks for 2 names where exactly one URI"),
    "a wildcard of DNS": (crafted((DNS_WILDCARD, True)), "asks for 1 names where exactly one URI"),
    "a wildcard": (crafted((uris("spiffe://home/*"), True)), r"name: '/\*' is not an absolute"),
    "a wildcard tail": (Robot("/rviz", wildcard=True).csr, "all names that begin with /rviz_"),
    "P-384": (crafted((SAN, True), key=P384), "a key that is not P-256"),
    "RSA": (rsa_request(), "a key that is not P-256"),
    "no proof of possession": (unproven(), "does not prove that the node has the key"),
    "an over-long name": (long_name(), "a name of 256 characters where at most 255"),
    "a NUL": (crafted(raw_name(b"spiffe://home/a\0b")), r"name: '/a\\x00b' is not an absolute"),
    "bidi": (crafted(BIDI), r"name: '/a\\u202eb' is not an absolute"),
    "another domain": (crafted((uris("spiffe://lab/a"), True)), "for trust domain 'lab'"),
    "too much": (bytes(2049), "a request of 2049 bytes"),
}


@pytest.mark.attack("hostile-request")
@pytest.mark.parametrize("flaw", HOSTILE)
def test_a_hostile_request_is_refused_with_its_own_error(flaw: str) -> None:
    """The code authenticates it, so the comparison passes: it is refused for its form."""
    csr, message = HOSTILE[flaw]
    core = AuthorityEnrollment(qr.parse(qr.label_code(csr)), "home")
    with pytest.raises(RequestRefused, match=message) as caught:
        core.receive(write(Delivery(csr)), clock())
    assert caught.value.hint
    assert "\u202e" not in str(caught.value)
    assert "\0" not in str(caught.value)
    assert core.state is AuthorityState.OVER
    with pytest.raises(EnrollmentRefused):
        core.approve(clock())


@pytest.mark.attack("hostile-request")
def test_the_corpus_is_not_empty_and_no_two_errors_are_one() -> None:
    messages = {message for _, message in HOSTILE.values()}
    assert len(messages) == len(HOSTILE) - 1 > 11  # two kinds of wrong key are one mistake
