import pytest

from ca.enrollment import invitation
from ca.enrollment.join import (
    AUTHORITY_TABLE,
    AuthorityJoin,
    AuthorityJoinState,
    ClaimMessage,
    Hello,
    Issued,
    Join,
    JoinMessage,
    LiveIdentity,
    Named,
    RefusedMessage,
    RefuseReason,
    WaitingMessage,
    WaitReason,
    Welcome,
    read,
    write,
)
from ca.errors import EnrollmentMessageRefused, EnrollmentOver, EnrollmentRefused
from tests.support.pki import new_signer

ID, NONCE, OWN = bytes(32), b"1" * 16, b"2" * 16
SIGNER = new_signer()
BUSY = RefusedMessage(RefuseReason.BUSY)
MESSAGES: list[JoinMessage] = [
    Hello(ID, NONCE),
    Welcome(NONCE, (b"c",), b"r", b"s"),
    Join("/a", b"csr", b"proof"),
    Issued((b"c",)),
    WaitingMessage(WaitReason.LOCKED),
    BUSY,
    ClaimMessage(b"<node/>", b"proof"),
    Named("/a"),
]


def session(*messages: JoinMessage) -> AuthorityJoin:
    core = AuthorityJoin(LiveIdentity(SIGNER, (b"leaf",), b"root"), OWN)
    for message in messages:
        core.receive(write(message))
    return core


def test_the_authority_shows_itself_and_hands_the_request_on() -> None:
    core = session()
    sent = core.receive(write(MESSAGES[0]))
    assert sent is not None
    welcome = read(sent)
    assert isinstance(welcome, Welcome)
    assert (welcome.nonce, welcome.chain, welcome.root) == (OWN, (b"leaf",), b"root")
    agreed = invitation.transcript(ID, NONCE, OWN, [b"leaf"], b"root")
    invitation.check_live(welcome.statement, SIGNER.public_key, agreed)
    assert core.receive(write(MESSAGES[2])) is None
    request = core.request
    assert (request.invitation, request.transcript) == (ID, agreed)
    assert (request.name, request.csr, request.proof) == ("/a", b"csr", b"proof")
    assert read(core.answer(BUSY)) == BUSY
    assert core.state is AuthorityJoinState.ANSWERED


@pytest.mark.parametrize(
    "begin", [(), (MESSAGES[0],), (MESSAGES[0], MESSAGES[2]), (MESSAGES[0], MESSAGES[6])]
)
@pytest.mark.parametrize("message", MESSAGES)
def test_what_is_not_in_the_table_ends_the_session(
    begin: tuple[JoinMessage, ...], message: JoinMessage
) -> None:
    core = session(*begin)
    if (core.state, type(message)) in AUTHORITY_TABLE:
        return
    with pytest.raises(EnrollmentMessageRefused, match="unexpected"):
        core.receive(write(message))
    assert core.state is AuthorityJoinState.OVER


def test_rubbish_ends_the_session() -> None:
    core = session()
    with pytest.raises(EnrollmentMessageRefused):
        core.receive(b"rubbish")
    with pytest.raises(EnrollmentMessageRefused, match="unexpected"):
        core.receive(write(MESSAGES[0]))


def test_a_name_that_is_not_ascii_ends_the_session() -> None:
    core = session(MESSAGES[0])
    with pytest.raises(EnrollmentMessageRefused):
        core.receive(write(Join("/é", b"", b"")))
    assert core.state is AuthorityJoinState.OVER


def test_one_answer_to_one_request() -> None:
    core = session(MESSAGES[0])
    with pytest.raises(EnrollmentOver):
        core.answer(BUSY)
    with pytest.raises(EnrollmentOver):
        _ = core.request
    core.receive(write(MESSAGES[2]))
    core.answer(BUSY)
    with pytest.raises(EnrollmentOver):
        core.answer(BUSY)


def test_a_claim_is_handed_on_and_the_request_follows_it() -> None:
    core = session(MESSAGES[0])
    with pytest.raises(EnrollmentOver):
        _ = core.claim
    with pytest.raises(EnrollmentOver):
        core.name(Named("/a"))
    assert core.receive(write(MESSAGES[6])) is None
    assert core.state is AuthorityJoinState.NAMING
    assert (core.claim.invitation, core.claim.metadata, core.claim.proof) == (ID, b"<node/>", b"proof")
    assert read(core.name(Named("/a"))) == Named("/a")
    core.receive(write(Join("/a", b"csr", b"proof", b"<node/>")))
    assert core.request.metadata == b"<node/>"
    assert core.request.transcript == core.claim.transcript


def test_one_claim_a_session_and_a_refused_one_ends_it() -> None:
    core = session(MESSAGES[0], MESSAGES[6])
    core.name(Named("/a"))
    with pytest.raises(EnrollmentMessageRefused, match="unexpected"):
        core.receive(write(MESSAGES[6]))
    core = session(MESSAGES[0], MESSAGES[6])
    assert read(core.name(RefusedMessage(RefuseReason.UNNAMED))) == RefusedMessage(RefuseReason.UNNAMED)
    with pytest.raises(EnrollmentMessageRefused, match="unexpected"):
        core.receive(write(MESSAGES[2]))


def test_a_nonce_has_its_size() -> None:
    with pytest.raises(EnrollmentRefused):
        AuthorityJoin(LiveIdentity(SIGNER, (b"leaf",), b"root"), b"")


# The transitions that no message causes.
AUTHORITY_WITHOUT_MESSAGE = (
    (AuthorityJoinState.NAMING, AuthorityJoinState.NAMED, "name()"),
    (AuthorityJoinState.NAMING, AuthorityJoinState.ANSWERED, "name()"),
    (AuthorityJoinState.DECIDING, AuthorityJoinState.ANSWERED, "answer()"),
)


def test_every_state_is_reached() -> None:
    reached = {follower for _, followers in AUTHORITY_TABLE.values() for follower in followers}
    reached |= {after for _, after, _ in AUTHORITY_WITHOUT_MESSAGE} | {AuthorityJoinState.GREETING}
    assert reached == set(AuthorityJoinState)
