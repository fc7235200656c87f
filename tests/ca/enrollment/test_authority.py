import pytest

from ca.enrollment import qr, sides
from ca.enrollment.messages import Abort, Acknowledgement, Delivery, Done, Fetch, Reason, read, write
from ca.enrollment.sides import AUTHORITY_TABLE, AuthorityEnrollment, AuthorityState
from ca.errors import (
    ConflictingOffer,
    EnrollmentExpired,
    EnrollmentMessageRefused,
    EnrollmentOver,
    EnrollmentRefused,
    ForeignCertificate,
    RequestRefused,
    RequestSwapped,
)
from tests.support.enrolling import WINDOW, Robot, acknowledged, compared, fresh, offered, scanned
from tests.support.pki import NOW, Site, new_signer

SITE, OTHER = Site.create(), Site.create()


def approved(label: bool = False) -> AuthorityEnrollment:
    enrollment = compared(Robot().enrollment(label=label))
    enrollment.approve(NOW)
    return enrollment


def test_a_node_is_enrolled_when_it_says_so() -> None:
    robot = Robot()
    node = robot.enrollment()
    authority, _ = acknowledged(node, SITE)
    assert authority.digits == node.pending.digits
    node.confirm(authority.digits, NOW)
    (done,) = node.activated()
    authority.receive(done, NOW)
    assert authority.state is AuthorityState.ENROLLED
    authority.receive(done, NOW + 10 * WINDOW)
    assert authority.state is AuthorityState.ENROLLED


def test_the_request_is_known_after_the_comparison() -> None:
    robot = Robot()
    node = robot.enrollment()
    enrollment = scanned(node)
    with pytest.raises(EnrollmentOver, match="no request yet"):
        _ = enrollment.request
    (delivery,) = node.receive(enrollment.fetch(), NOW)
    enrollment.receive(delivery, NOW)
    assert enrollment.request.name == robot.name
    assert enrollment.csr == robot.csr
    assert enrollment.deadline == NOW + WINDOW


def test_a_swapped_request() -> None:
    """Of the same name, in order in itself, with another key: the code does not vouch for it."""
    enrollment = scanned(Robot().enrollment())
    with pytest.raises(RequestSwapped, match="not the one the code was made for"):
        enrollment.receive(write(Delivery(Robot().csr)), NOW)
    assert enrollment.state is AuthorityState.OVER


def test_a_code_for_what_is_no_request() -> None:
    enrollment = AuthorityEnrollment(qr.parse(qr.label_code(b"garbage")), "home")
    with pytest.raises(RequestRefused, match="not a certificate request"):
        enrollment.receive(write(Delivery(b"garbage")), NOW)
    assert enrollment.state is AuthorityState.OVER


def test_a_wildcard_tail_is_meant_on_both_sides() -> None:
    robot = Robot("/rviz", wildcard=True)
    code = qr.parse(robot.enrollment().code("x"))
    with pytest.raises(RequestRefused, match="all names that begin with /rviz_"):
        AuthorityEnrollment(code, "home").receive(write(Delivery(robot.csr)), NOW)
    enrollment = AuthorityEnrollment(code, "home", wildcard=True)
    enrollment.receive(write(Delivery(robot.csr)), NOW)
    enrollment.approve(NOW)
    namesake = Robot("/rviz", robot.signer)
    plain = SITE.authority.issue(namesake.csr, now=NOW, serial=1)
    with pytest.raises(EnrollmentRefused, match="not the one that was asked for"):
        enrollment.offer([plain], SITE.root, fresh(), NOW)
    tail = SITE.authority.issue(robot.csr, now=NOW, serial=1, wildcard=True)
    assert enrollment.offer([tail], SITE.root, fresh(), NOW)


def test_nothing_is_offered_without_approval() -> None:
    robot = Robot()
    enrollment = compared(robot.enrollment())
    leaf = SITE.authority.issue(robot.csr, now=NOW, serial=1)
    with pytest.raises(EnrollmentOver, match="in state 'request verified'"):
        enrollment.offer([leaf], SITE.root, fresh(), NOW)
    enrollment.deny()
    with pytest.raises(EnrollmentOver):
        enrollment.approve(NOW)


def test_only_what_was_asked_for_is_offered() -> None:
    enrollment = approved()
    for robot in (Robot(), Robot("/other")):
        leaf = SITE.authority.issue(robot.csr, now=NOW, serial=1)
        with pytest.raises(EnrollmentRefused, match="not the one that was asked for"):
            enrollment.offer([leaf], SITE.root, fresh(), NOW)
    leaf = SITE.authority.issue(enrollment.csr, now=NOW, serial=1)
    with pytest.raises(ForeignCertificate):
        enrollment.offer([leaf], OTHER.root, fresh(), NOW)
    with pytest.raises(EnrollmentRefused, match="a nonce has 16 octets"):
        enrollment.offer([leaf], SITE.root, b"", NOW)
    assert enrollment.offer([leaf], SITE.root, fresh(), NOW)


def test_the_answer_of_another_key() -> None:
    node = Robot().enrollment()
    authority, offer = offered(node, SITE)
    node.receive(offer, NOW)
    statement = sides.sign_acknowledgement(new_signer(), node.pending.transcript, fresh())
    with pytest.raises(EnrollmentRefused, match="not signed by the node"):
        authority.receive(write(Acknowledgement(statement)), NOW)
    assert authority.state is AuthorityState.OVER


def test_a_replayed_answer() -> None:
    """Recorded at the first enrollment of the very same key, played back at the second."""
    robot = Robot()
    first = robot.enrollment()
    _, offer = offered(first, SITE)
    (recorded,) = first.receive(offer, NOW)
    later, _ = offered(robot.enrollment(), SITE)
    with pytest.raises(EnrollmentRefused, match="for another offer"):
        later.receive(recorded, NOW)
    assert later.state is AuthorityState.OVER
    assert later.digits == ""


def test_a_replayed_last_word() -> None:
    robot = Robot()
    first = robot.enrollment()
    authority, _ = acknowledged(first, SITE)
    first.confirm(authority.digits, NOW)
    (recorded,) = first.activated()
    later, _ = acknowledged(robot.enrollment(), SITE)
    with pytest.raises(EnrollmentRefused, match="for another offer"):
        later.receive(recorded, NOW)
    assert later.state is AuthorityState.OVER
    authority.receive(recorded, NOW)
    with pytest.raises(EnrollmentRefused, match="not signed by the node"):
        authority.receive(write(Done(b"no")), NOW)
    assert authority.state is AuthorityState.ENROLLED


def test_the_last_word_before_the_answer_changes_nothing() -> None:
    node = Robot().enrollment()
    authority, offer = offered(node, SITE)
    (answer,) = node.receive(offer, NOW)
    node.confirm(node.pending.digits, NOW)
    (done,) = node.activated()
    with pytest.raises(EnrollmentMessageRefused, match="unexpected Done in state 'waiting for the ack"):
        authority.receive(done, NOW)
    for message in (answer, answer, done, answer):
        authority.receive(message, NOW)
    assert authority.state is AuthorityState.ENROLLED


def test_a_second_different_answer() -> None:
    node = Robot().enrollment()
    authority, _ = acknowledged(node, SITE)
    other = sides.sign_acknowledgement(new_signer(), node.pending.transcript, fresh())
    with pytest.raises(EnrollmentRefused, match="a second, different answer"):
        authority.receive(write(Acknowledgement(other)), NOW)
    assert authority.digits == node.pending.digits


@pytest.mark.parametrize(
    ("reason", "kind", "message"),
    [
        (Reason.REFUSED, EnrollmentOver, "refused the offer"),
        (Reason.OVER, EnrollmentOver, "has ended the enrollment"),
        (Reason.CONFLICT, ConflictingOffer, "two different offers"),
    ],
)
def test_the_node_gives_up(reason: Reason, kind: type[Exception], message: str) -> None:
    node = Robot().enrollment()
    for authority in (scanned(node), offered(node, SITE)[0], acknowledged(node, SITE)[0]):
        with pytest.raises(kind, match=message):
            authority.receive(write(Abort(reason)), NOW)
        assert authority.state is AuthorityState.OVER
        with pytest.raises(EnrollmentMessageRefused):
            authority.receive(write(Abort(reason)), NOW)


def test_a_screen_code_ends() -> None:
    enrollment = compared(Robot().enrollment())
    with pytest.raises(EnrollmentExpired, match="not finished in time"):
        enrollment.approve(NOW + WINDOW + 1)
    assert enrollment.state is AuthorityState.OVER
    enrollment.tick(NOW + WINDOW + 2)


def test_a_label_has_no_end_but_its_offer_has() -> None:
    node = Robot().enrollment(label=True, now=NOW + 10 * WINDOW)
    authority, offer = offered(node, SITE, NOW + 10 * WINDOW)
    later = NOW + 11 * WINDOW
    assert authority.deadline == later
    for answer in node.receive(offer, later):
        authority.receive(answer, later)
    with pytest.raises(EnrollmentExpired):
        authority.tick(later + WINDOW + 1)


def test_invalid_messages_are_refused() -> None:
    enrollment = scanned(Robot().enrollment())
    with pytest.raises(EnrollmentMessageRefused):
        enrollment.receive(b"garbage", NOW)
    assert enrollment.state is AuthorityState.FETCHING


WITHOUT_MESSAGE = {AuthorityState.APPROVED, AuthorityState.OFFERED, AuthorityState.OVER}
"""The states that no message leads to: after a call, or too late."""


def test_the_table_names_methods_that_exist() -> None:
    assert all(callable(getattr(AuthorityEnrollment, method)) for method, _ in AUTHORITY_TABLE.values())
    reached = {end for _, ends in AUTHORITY_TABLE.values() for end in ends}
    assert reached | WITHOUT_MESSAGE == set(AuthorityState) - {AuthorityState.FETCHING}
    assert isinstance(read(scanned(Robot().enrollment()).fetch()), Fetch)
