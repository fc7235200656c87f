import re
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import pytest

from ca.enrollment.invitation import InvitationCode
from ca.enrollment.join import (
    NODE_TABLE,
    AuthorityJoin,
    AuthorityJoinState,
    ClaimMessage,
    Hello,
    Issued,
    Join,
    JoinMessage,
    LiveIdentity,
    Named,
    NodeJoin,
    NodeJoinState,
    RefusedMessage,
    RefuseReason,
    WaitingMessage,
    WaitReason,
    Welcome,
    read,
    write,
)
from ca.errors import (
    EnrollmentMessageRefused,
    EnrollmentOver,
    EnrollmentRefused,
    JoinBusy,
    JoinRefused,
    JoinWaiting,
    NameRefused,
    RequestRefused,
)
from ca.keys.signing import KeySigner
from ca.svid import build_request
from tests.support.joining import fresh
from tests.support.pki import NOW, Site, new_signer

HOME, OTHER = Site.create(), Site.create()
OWN, NODE = new_signer(), new_signer()


def leaf(name: str, signer: KeySigner, site: Site = HOME, now: int = NOW) -> bytes:
    csr = build_request(signer, "home", name)
    return site.authority.issue(csr, now=now, serial=int.from_bytes(fresh()) + 9)


CA_LEAF = leaf("/ca", OWN)
CSR = build_request(NODE, "home", "/fleet/a")
CODE = InvitationCode(sha256(HOME.root).digest(), bytes(16), NOW + 9, "10.0.0.1:1", "/fleet/*")


def identity(chain: bytes = CA_LEAF, signer: KeySigner = OWN, root: bytes = HOME.root) -> LiveIdentity:
    return LiveIdentity(signer, (chain,), root)


def welcomed(node: NodeJoin, own: LiveIdentity | None = None) -> bytes:
    sent = AuthorityJoin(own or identity(), fresh()).receive(node.hello())
    assert sent is not None
    return sent


def proved(csr: bytes = CSR, code: InvitationCode = CODE) -> NodeJoin:
    node = NodeJoin(code, fresh())
    node.receive(welcomed(node), NOW)
    node.join(csr)
    return node


def test_a_node_joins() -> None:
    node, authority = NodeJoin(CODE, fresh()), AuthorityJoin(identity(), fresh())
    welcome = authority.receive(node.hello())
    assert welcome is not None
    node.receive(welcome, NOW)
    assert node.anchor.domain == "home"
    assert authority.receive(node.join(CSR)) is None
    authority.request.verify(CODE.key)
    mine = HOME.authority.issue(CSR, now=NOW, serial=77)
    node.receive(authority.answer(Issued((mine,))), NOW)
    assert node.state is NodeJoinState.JOINED
    assert (node.identity.chain, node.identity.root) == ((mine,), HOME.root)
    assert node.identity.anchor.thumbprint == HOME.anchor.thumbprint


def impostors() -> dict[str, tuple[LiveIdentity, str]]:
    robot = new_signer()
    return {
        "another authority": (
            identity(leaf("/ca", OWN, OTHER), root=OTHER.root),
            "another authority answers",
        ),
        "the same root, its leaf of another": (identity(leaf("/ca", OWN, OTHER)), "is not the authority"),
        "an enrolled node": (
            identity(leaf("/robot", robot), robot),
            "the peer is /robot, a node of this site",
        ),
        "a node with a name like it": (identity(leaf("/ca/ca", robot), robot), "is /ca/ca"),
        "the master": (identity(leaf("/master", robot), robot), "the peer is /master"),
        "a copy of the certificate without its key": (identity(CA_LEAF, robot), "does not have the key"),
        "the root itself as the leaf": (identity(HOME.root, KeySigner(HOME.key)), "not the"),
        "rubbish": (identity(b"rubbish"), "is not the authority"),
    }


IMPOSTORS = impostors()


@pytest.mark.parametrize("which", sorted(IMPOSTORS))
def test_a_peer_that_is_not_the_live_authority_gets_nothing(which: str) -> None:
    own, error = IMPOSTORS[which]
    node = NodeJoin(CODE, fresh())
    with pytest.raises(EnrollmentRefused, match=error):
        node.receive(welcomed(node, own), NOW)
    assert node.state is NodeJoinState.OVER
    with pytest.raises(EnrollmentOver):
        node.join(CSR)
    with pytest.raises(EnrollmentOver):
        _ = node.anchor


def test_an_authority_whose_identity_has_expired() -> None:
    node = NodeJoin(CODE, fresh())
    with pytest.raises(EnrollmentRefused, match=r"cannot be verified: .* expired") as caught:
        node.receive(welcomed(node), NOW + 31 * 86400)
    assert "this computer's clock" in caught.value.hint, "it is the node that may be wrong"


def test_a_recorded_welcome_is_not_live() -> None:
    first, second = NodeJoin(CODE, fresh()), NodeJoin(CODE, fresh())
    recorded = welcomed(first)
    with pytest.raises(EnrollmentRefused, match="does not have the key"):
        second.receive(recorded, NOW)


def test_a_welcome_for_another_invitation_is_not_live() -> None:
    nonce = fresh()
    first, second = NodeJoin(replace(CODE, secret=b"1" * 16), nonce), NodeJoin(CODE, nonce)
    with pytest.raises(EnrollmentRefused, match="does not have the key"):
        second.receive(welcomed(first), NOW)


def test_a_root_that_is_not_parsed_before_its_hash() -> None:
    node = NodeJoin(CODE, fresh())
    with pytest.raises(EnrollmentRefused, match="another authority"):
        node.receive(write(Welcome(fresh(), (b"c",), b"rubbish", b"s")), NOW)


@pytest.mark.parametrize(
    ("chain", "error"),
    [
        ((leaf("/fleet/a", new_signer()),), "another key"),
        ((leaf("/fleet/b", NODE),), "another name"),
        ((leaf("/fleet/a", NODE, OTHER),), "invalid offer"),
        ((HOME.root,), "invalid offer"),
        ((b"rubbish",), "invalid offer"),
    ],
)
def test_only_its_own_identity_is_taken(chain: tuple[bytes, ...], error: str) -> None:
    node = proved()
    with pytest.raises(EnrollmentRefused, match=error):
        node.receive(write(Issued(chain)), NOW)
    assert node.state is NodeJoinState.OVER
    with pytest.raises(EnrollmentOver):
        _ = node.identity


@pytest.mark.parametrize("reason", WaitReason)
def test_waiting_is_raised(reason: WaitReason) -> None:
    node = proved()
    with pytest.raises(JoinWaiting) as caught:
        node.receive(write(WaitingMessage(reason)), NOW)
    assert "rossec node join" in caught.value.hint
    assert node.state is NodeJoinState.WAITING


@pytest.mark.parametrize("reason", RefuseReason)
@pytest.mark.parametrize("early", [True, False])
def test_a_refusal_is_raised(reason: RefuseReason, early: bool) -> None:
    node = NodeJoin(CODE, fresh()) if early else proved()
    kind = JoinBusy if reason is RefuseReason.BUSY else JoinRefused
    with pytest.raises(kind) as caught:
        node.receive(write(RefusedMessage(reason)), NOW)
    assert type(caught.value) is kind
    assert caught.value.hint
    assert node.state is NodeJoinState.OVER


MESSAGES: list[JoinMessage] = [
    Hello(bytes(32), bytes(16)),
    Welcome(bytes(16), (b"c",), b"r", b"s"),
    Join("/a", b"", b""),
    Issued((b"c",)),
    WaitingMessage(WaitReason.LOCKED),
    RefusedMessage(RefuseReason.BUSY),
    ClaimMessage(b"<node/>", b""),
    Named("/fleet/a"),
]
METADATA = b"<node><name>a</name></node>"


def claimed() -> NodeJoin:
    node = NodeJoin(CODE, fresh())
    node.receive(welcomed(node), NOW)
    node.claim(METADATA)
    return node


def test_a_node_takes_the_name_that_the_authority_gives() -> None:
    node, authority = NodeJoin(CODE, fresh()), AuthorityJoin(identity(), fresh())
    welcome = authority.receive(node.hello())
    assert welcome is not None
    node.receive(welcome, NOW)
    authority.receive(node.claim(METADATA))
    authority.claim.verify(CODE.key)
    assert authority.claim.metadata == METADATA
    with pytest.raises(EnrollmentOver):
        _ = node.name
    node.receive(authority.name(Named("/fleet/a")), NOW)
    assert node.name == "/fleet/a"
    with pytest.raises(RequestRefused, match="not for /fleet/a"):
        node.join(build_request(NODE, "home", "/fleet/b"))
    authority.receive(node.join(CSR))
    authority.request.verify(CODE.key)
    assert (authority.request.name, authority.request.metadata) == ("/fleet/a", METADATA)
    with pytest.raises(JoinRefused):
        replace(authority.request, metadata=b"").verify(CODE.key)
    with pytest.raises(EnrollmentOver):
        node.claim(METADATA)


@pytest.mark.parametrize("name", ["/other", "/fleet/a/b", "/fleet", "/ca", "/master", "/relay"])
def test_a_name_that_the_invitation_does_not_allow_is_not_taken(name: str) -> None:
    node = claimed()
    with pytest.raises(EnrollmentRefused, match=f"the name {name}, which"):
        node.receive(write(Named(name)), NOW)
    assert node.state is NodeJoinState.OVER


@pytest.mark.parametrize("name", ["", "fleet/a", "/fleet/~a", "/fleet/a b"])
def test_a_text_that_is_no_name_is_not_taken(name: str) -> None:
    node = claimed()
    with pytest.raises(NameRefused):
        node.receive(write(Named(name)), NOW)
    with pytest.raises(EnrollmentOver):
        node.join(CSR)


@pytest.mark.parametrize("reason", RefuseReason)
def test_a_refused_claim_is_raised(reason: RefuseReason) -> None:
    node = claimed()
    kind = JoinBusy if reason is RefuseReason.BUSY else JoinRefused
    with pytest.raises(kind) as caught:
        node.receive(write(RefusedMessage(reason)), NOW)
    assert type(caught.value) is kind
    assert node.state is NodeJoinState.OVER


@pytest.mark.parametrize("metadata", [b"", bytes(4097)])
def test_metadata_have_a_size(metadata: bytes) -> None:
    node = NodeJoin(CODE, fresh())
    with pytest.raises(EnrollmentOver):
        node.claim(METADATA)
    node.receive(welcomed(node), NOW)
    with pytest.raises(EnrollmentMessageRefused, match="where 1 to 4096"):
        node.claim(metadata)
    node.join(CSR)


def test_metadata_may_come_with_the_request_alone() -> None:
    node, authority = NodeJoin(CODE, fresh()), AuthorityJoin(identity(), fresh())
    welcome = authority.receive(node.hello())
    assert welcome is not None
    node.receive(welcome, NOW)
    with pytest.raises(EnrollmentMessageRefused, match="where 1 to 4096"):
        node.join(CSR, bytes(4097))
    authority.receive(node.join(CSR, METADATA))
    authority.request.verify(CODE.key)
    assert authority.request.metadata == METADATA
    with pytest.raises(JoinRefused, match="another name"):
        node.receive(authority.answer(RefusedMessage(RefuseReason.NAME)), NOW)


@pytest.mark.parametrize("state", NodeJoinState)
@pytest.mark.parametrize("message", MESSAGES)
def test_what_is_not_in_the_table_ends_the_session(state: NodeJoinState, message: JoinMessage) -> None:
    if (state, type(message)) in NODE_TABLE:
        return
    node = NodeJoin(CODE, fresh())
    node.state = state
    with pytest.raises(EnrollmentMessageRefused, match="unexpected"):
        node.receive(write(message), NOW)
    assert node.state in {NodeJoinState.OVER, NodeJoinState.WAITING}


@pytest.mark.parametrize(
    "csr",
    [
        b"rubbish",
        build_request(NODE, "elsewhere", "/fleet/a"),
        build_request(NODE, "home", "/fleet/a", wildcard=True),
    ],
)
def test_a_request_that_is_invalid_is_not_sent(csr: bytes) -> None:
    node = NodeJoin(CODE, fresh())
    node.receive(welcomed(node), NOW)
    with pytest.raises(RequestRefused):
        node.join(csr)
    assert isinstance(read(node.join(CSR)), Join)
    with pytest.raises(EnrollmentOver):
        node.join(CSR)


def test_a_nonce_has_its_size() -> None:
    with pytest.raises(EnrollmentRefused):
        NodeJoin(CODE, b"")


def test_the_states_are_those_of_the_specification() -> None:
    text = (Path(__file__).parents[3] / "docs" / "spec" / "enrollment.md").read_text()
    node = text.partition("## 11.")[2].partition("## 12.")[0]
    authority = text.partition("## 12.")[2].partition("## 13.")[0]
    for states, section in ((NodeJoinState, node), (AuthorityJoinState, authority)):
        found = set(re.findall(r"\b[A-Z]{4,}\b", section)) - {"MUST", "SHOULD", "FALSE"}
        assert found == {state.name for state in states}


# The transitions that no message causes.
NODE_WITHOUT_MESSAGE = (
    (NodeJoinState.WELCOMED, NodeJoinState.CLAIMED, "claim()"),
    (NodeJoinState.WELCOMED, NodeJoinState.PROVED, "join()"),
    (NodeJoinState.NAMED, NodeJoinState.PROVED, "join()"),
)


def test_every_state_is_reached() -> None:
    reached = {follower for _, followers in NODE_TABLE.values() for follower in followers}
    reached |= {after for _, after, _ in NODE_WITHOUT_MESSAGE} | {NodeJoinState.GREETING}
    assert reached == set(NodeJoinState)
