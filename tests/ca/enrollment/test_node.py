import pytest

from ca.enrollment import qr, sides
from ca.enrollment.messages import Abort, Acknowledgement, Done, EnrollmentOffer, Reason, read, write
from ca.enrollment.sides import MAX_BAD_DIGITS, MAX_BAD_TAGS, NODE_TABLE, NodeEnrollment, NodeState
from ca.errors import (
    ConflictingOffer,
    EnrollmentExpired,
    EnrollmentMessageRefused,
    EnrollmentOver,
    EnrollmentRefused,
    RequestRefused,
)
from ca.svid import build_request
from tests.support import refusal_texts
from tests.support.enrolling import ADDRESS, WINDOW, Robot, acknowledged, fresh, offered, scanned
from tests.support.pki import NOW, Site, new_signer

SITE, OTHER = Site.create(), Site.create()


def wrong(digits: str) -> str:
    return str((int(digits) + 1) % 10**6).zfill(6)


def test_a_screen_code_and_a_label() -> None:
    robot = Robot()
    code = qr.parse(robot.enrollment().code(ADDRESS))
    assert code.matches(robot.csr)
    assert (code.address, code.expires) == (ADDRESS, NOW + WINDOW)
    assert robot.enrollment(label=True).code() == qr.label_code(robot.csr)


def test_the_secret_is_as_long_as_it_should_be() -> None:
    robot = Robot()
    with pytest.raises(EnrollmentRefused, match="16 octets of each"):
        robot.enrollment(contribution=b"short")
    robot.csr = b"garbage"
    with pytest.raises(RequestRefused):
        robot.enrollment()


@pytest.mark.parametrize("label", [False, True])
def test_nothing_counts_before_a_person_confirmed(label: bool) -> None:
    node = Robot().enrollment(label=label)
    with pytest.raises(EnrollmentOver, match="no offer to confirm"):
        node.confirm("000000", NOW)
    with pytest.raises(EnrollmentOver, match="nothing was confirmed"):
        node.activated()
    authority, _ = acknowledged(node, SITE)
    assert node.pending.digits == authority.digits
    with pytest.raises(EnrollmentOver, match="nothing was confirmed"):
        node.activated()
    pending = node.confirm(authority.digits, NOW + 1)
    assert (pending.root, pending.anchor.thumbprint) == (SITE.root, SITE.anchor.thumbprint)
    with pytest.raises(EnrollmentOver, match="confirmed already"):
        node.confirm(authority.digits, NOW + 1)
    (done,) = node.activated()
    assert isinstance(read(done), Done)
    assert node.state is NodeState.ENROLLED


def test_the_same_offer_again_gets_the_same_answer() -> None:
    """To the letter: a fresh contribution each time would let an attacker choose the digits."""
    node = Robot().enrollment()
    _, offer = offered(node, SITE)
    first = node.receive(offer, NOW)
    assert node.receive(offer, NOW + 1) == first
    node.confirm(node.pending.digits, NOW)
    assert node.receive(offer, NOW + 1) == first
    node.activated()
    again = node.receive(offer, NOW + WINDOW * 9)
    assert again[0] == first[0]
    assert isinstance(read(again[1]), Done)


@pytest.mark.parametrize("label", [False, True])
@pytest.mark.parametrize("rival", [SITE, OTHER], ids=["same authority", "other authority"])
def test_a_second_valid_offer_drops_both(label: bool, rival: Site) -> None:
    node = Robot().enrollment(label=label)
    acknowledged(node, SITE)
    _, offer = offered(node, rival)
    with pytest.raises(ConflictingOffer, match="another party has its code"):
        node.receive(offer, NOW)
    assert node.state is NodeState.OVER
    with pytest.raises(
        EnrollmentOver, match="the enrollment is over: this node received two different offers"
    ):
        node.confirm("000000", NOW)


def test_a_rival_while_the_disk_is_written() -> None:
    node = Robot().enrollment()
    authority, _ = acknowledged(node, SITE)
    rival = scanned(node)
    (delivery,) = node.receive(rival.fetch(), NOW)
    rival.receive(delivery, NOW)
    rival.approve(NOW)
    certificate = OTHER.authority.issue(rival.csr, now=NOW, serial=5)
    offer = rival.offer([certificate], OTHER.root, fresh(), NOW)
    node.confirm(authority.digits, NOW)
    with pytest.raises(ConflictingOffer):
        node.receive(offer, NOW)
    with pytest.raises(EnrollmentOver):
        node.activated()


def test_an_offer_after_the_enrollment() -> None:
    node = Robot().enrollment()
    authority, offer = acknowledged(node, SITE)
    node.confirm(authority.digits, NOW)
    node.activated()
    changed = read(offer)
    assert isinstance(changed, EnrollmentOffer)
    other = write(EnrollmentOffer(changed.chain, changed.root, fresh(), changed.tag))
    with pytest.raises(EnrollmentOver, match="enrolled already"):
        node.receive(other, NOW)
    node.stop(EnrollmentOver("too late to stop"))
    assert node.state is NodeState.ENROLLED


def test_five_bad_tags_lock_the_code() -> None:
    node = Robot().enrollment()
    _, offer = offered(node, SITE)
    bad = forged(offer)
    for _ in range(MAX_BAD_TAGS - 1):
        with pytest.raises(EnrollmentRefused, match="has not read the code"):
            node.receive(bad, NOW)
    with pytest.raises(EnrollmentOver, match="5 offers without the code's secret"):
        node.receive(bad, NOW)
    with pytest.raises(EnrollmentOver, match="over: 5 offers"):
        node.receive(offer, NOW)


def forged(offer: bytes, tag: bytes = bytes(32)) -> bytes:
    message = read(offer)
    assert isinstance(message, EnrollmentOffer)
    return write(EnrollmentOffer(message.chain, message.root, fresh(), tag))


def test_bad_tags_do_not_disturb_an_offer_that_waits() -> None:
    node = Robot().enrollment()
    authority, offer = acknowledged(node, SITE)
    for _ in range(2 * MAX_BAD_TAGS):
        with pytest.raises(EnrollmentRefused, match="has not read the code"):
            node.receive(forged(offer), NOW)
    assert node.confirm(authority.digits, NOW).digits == authority.digits


def test_an_offer_without_a_tag_is_not_for_a_screen_code() -> None:
    node = Robot().enrollment()
    _, offer = offered(node, SITE)
    with pytest.raises(EnrollmentRefused, match="has not read the code"):
        node.receive(forged(offer, b""), NOW)


def test_an_offer_with_a_tag_is_not_for_a_label() -> None:
    node = Robot().enrollment(label=True)
    _, offer = offered(node, SITE)
    with pytest.raises(EnrollmentRefused, match="an offer with a tag"):
        node.receive(forged(offer), NOW)


def crafted(robot: Robot, chain: tuple[bytes, ...], root: bytes) -> bytes:
    return write(EnrollmentOffer(chain, root, fresh(), b""))


def test_an_identity_for_somebody_else() -> None:
    robot, namesake, other = Robot(), Robot(), Robot("/other")
    other.signer = robot.signer
    other.__post_init__()
    node = robot.enrollment(label=True)
    for csr, message in ((namesake.csr, "for another key"), (other.csr, "for another name")):
        leaf = SITE.authority.issue(csr, now=NOW, serial=3)
        with pytest.raises(EnrollmentRefused, match=message):
            node.receive(crafted(robot, (leaf,), SITE.root), NOW)
    elsewhere = Site.create("lab")
    leaf = elsewhere.authority.issue(build_request(robot.signer, "lab", robot.name), now=NOW, serial=3)
    with pytest.raises(EnrollmentRefused, match="for another name"):
        node.receive(crafted(robot, (leaf,), elsewhere.root), NOW)
    assert node.state is NodeState.SHOWING


def test_a_wildcard_tail_is_given_to_who_asked_for_it() -> None:
    for asked in (False, True):
        robot = Robot("/rviz", wildcard=asked)
        node = robot.enrollment(label=True)
        namesake = Robot("/rviz", robot.signer, wildcard=not asked)
        given, other = (
            SITE.authority.issue(each.csr, now=NOW, serial=3, wildcard=each.wildcard)
            for each in (robot, namesake)
        )
        with pytest.raises(EnrollmentRefused, match="for another name"):
            node.receive(crafted(robot, (other,), SITE.root), NOW)
        assert node.receive(crafted(robot, (given,), SITE.root), NOW)


def test_certificates_that_do_not_hold() -> None:
    robot = Robot()
    node = robot.enrollment(label=True)
    leaf = SITE.authority.issue(robot.csr, now=NOW, serial=3)
    for chain, root in (
        ((leaf,), OTHER.root),
        ((leaf,), leaf),
        ((leaf,), b"x"),
        ((b"x",), SITE.root),
        ((SITE.root,), SITE.root),
    ):
        with pytest.raises(EnrollmentRefused, match="invalid offer"):
            node.receive(crafted(robot, chain, root), NOW)
    expired = SITE.authority.issue(robot.csr, now=NOW, serial=3, lifetime=1)
    with pytest.raises(EnrollmentRefused, match="expired"):
        node.receive(crafted(robot, (expired,), SITE.root), NOW + 10)


def test_a_code_ends() -> None:
    node = Robot().enrollment()
    _, offer = offered(node, SITE)
    node.tick(NOW + WINDOW)
    assert node.state is NodeState.SHOWING
    with pytest.raises(EnrollmentOver, match="over: the enrollment was not finished in time"):
        node.receive(offer, NOW + WINDOW + 1)
    assert isinstance(node.end_reason, EnrollmentExpired)


def test_an_offer_ends() -> None:
    node = Robot().enrollment()
    authority, _ = acknowledged(node, SITE, NOW + 10)
    assert node.expires == NOW + 10 + WINDOW
    with pytest.raises(EnrollmentOver, match="in time"):
        node.confirm(authority.digits, NOW + 11 + WINDOW)


def test_three_wrong_digits() -> None:
    node = Robot().enrollment()
    authority, _ = acknowledged(node, SITE)
    for _ in range(MAX_BAD_DIGITS):
        with pytest.raises(EnrollmentRefused, match="not the digits") as caught:
            node.confirm(wrong(authority.digits), NOW)
        assert "possible attacker in between" in caught.value.hint
    with pytest.raises(EnrollmentOver, match="over: these are not the digits"):
        node.confirm(authority.digits, NOW)


def test_an_unexpected_message_changes_nothing() -> None:
    node = Robot().enrollment()
    for message in (Abort(Reason.OVER), Acknowledgement(b""), Done(b"")):
        with pytest.raises(EnrollmentMessageRefused, match="in state 'waiting for an offer'"):
            node.receive(write(message), NOW)
    with pytest.raises(EnrollmentMessageRefused):
        node.receive(b"garbage", NOW)
    assert node.state is NodeState.SHOWING


class Recorder:
    """A signer that remembers what it signed."""

    def __init__(self) -> None:
        self.inner = new_signer()
        self.public_key = self.inner.public_key
        self.signed: list[bytes] = []

    def sign(self, message: bytes) -> bytes:
        self.signed.append(message)
        return self.inner.sign(message)


def test_a_node_signs_nothing_a_peer_chose() -> None:
    """Whatever is offered, what is signed is a hash under a context of this protocol alone."""
    recorder = Recorder()
    robot = Robot(signer=recorder)  # type: ignore[arg-type]  # a signer all the same
    recorder.signed.clear()
    node = robot.enrollment(label=True)
    for payload in (b"pay the attacker", SITE.root, bytes(32)):
        offer = crafted(robot, (payload,), payload)
        with pytest.raises(EnrollmentRefused, match=refusal_texts.OFFER_REFUSED):
            node.receive(offer, NOW)
    assert recorder.signed == []
    authority, _ = acknowledged(node, SITE)
    node.confirm(authority.digits, NOW)
    node.activated()
    contexts = (b"rossec-enroll-ack+cbor", b"rossec-enroll-done+cbor")
    assert len(recorder.signed) == 2
    for signed, context in zip(recorder.signed, contexts, strict=True):
        assert signed.startswith(b"\x84\x6aSignature1")
        assert context in signed
        assert node.pending.transcript in signed


WITHOUT_MESSAGE = {NodeState.CONFIRMED, NodeState.ENROLLED, NodeState.OVER}
"""The states that no message leads to: after a call, or too late."""


def test_the_table_names_methods_that_exist() -> None:
    assert all(callable(getattr(NodeEnrollment, method)) for method, _ in NODE_TABLE.values())
    reached = {end for _, ends in NODE_TABLE.values() for end in ends}
    assert reached | WITHOUT_MESSAGE == set(NodeState)
    assert not any(begin is NodeState.OVER for begin, _ in NODE_TABLE)


def test_the_digits_depend_on_what_the_node_reveals_last() -> None:
    """The same offer, octet by octet, gives other digits with another contribution."""
    robot = Robot()
    first, second = robot.enrollment(label=True), robot.enrollment(label=True)
    _, offer = offered(first, SITE)
    first.receive(offer, NOW)
    second.receive(offer, NOW)
    assert first.pending.transcript == second.pending.transcript
    assert first.pending.digits != second.pending.digits
    assert sides.group_digits(first.pending.digits)[3] == " "
