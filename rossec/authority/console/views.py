"""What the service shows the console, as records (`records`). Pure.

Times are seconds since the epoch, durations seconds; ids, digests and keys (COSE thumbprints) are
bytes. Texts of nodes are as the nodes wrote them: whoever shows them escapes them.
"""

from typing import NamedTuple


class Status(NamedTuple):
    """The service: `number` changes whenever anything that the console can show has changed."""

    domain: str
    fingerprint: str
    locked: bool
    remaining: int | None  # seconds; 0: until it is locked; None: it is locked
    number: int
    now: int
    phones: int  # passkeys that can approve
    has_master: bool  # whether the last call to the master succeeded


class NodeView(NamedTuple):
    """An identity: the newest of its name, or another key of it that is still valid."""

    name: str
    key: bytes
    not_before: int
    not_after: int
    anonymous: bool  # for anonymous nodes too
    revoked_at: int  # 0: it is not revoked
    reason: str


class GrantView(NamedTuple):
    """A signed grant; `data` is its COSE form (`grants.document.peek`)."""

    id: bytes
    node: str
    data: bytes
    at: int  # when it was signed
    expires: int
    cap: int  # until when the master renews it
    revoked_at: int  # 0: it is not revoked
    reason: str
    rules: str  # of the policy; empty: by hand
    delivery: str  # as `rossec grant list` shows it: held, fetched, waiting; empty: not known


class IdentityRequestView(NamedTuple):
    """A request for an identity that waits: for a person (`pending`), or the key (`approved`)."""

    id: bytes
    name: str
    key: bytes
    source: str
    arrived: int
    expires: int
    state: str
    anonymous: bool
    is_other_key: bool  # the name has, or had, another key
    csr: bytes  # DER, as `PREPARED` of "enroll" takes it


class AskedRight(NamedTuple):
    """One right that a node asks for, as the policy would grant it (see `grants.claims`)."""

    right: int
    pattern: str
    type: str  # of the messages; empty: not known
    rules: str
    why: str  # the reason in the policy, not the node's
    permissions: bytes  # CBOR list of the AIF entries that would be granted


class GrantQuestion(NamedTuple):
    """A right that a node asks for, and that waits for a person.

    A request for several rights is as many questions, and `request` is the id that they share.
    """

    id: bytes
    node: str
    key: bytes
    why: str  # the node's own words
    at: int
    expires: int  # denied afterwards
    lifetime: int  # seconds that would be granted, renewals by the master included
    coarse: tuple[str, ...]  # names of filters that could be put on it
    rights: tuple[AskedRight, ...]
    request: bytes = b""


class QuestionAnswer(NamedTuple):
    """The answer to a question: `granted`, `denied`, or why nobody gave one."""

    node: str
    right: int
    pattern: str
    answer: str
    reason: str
    at: int


class InvitationView(NamedTuple):
    """A join code; `state` is `open`, or why it is not."""

    id: bytes
    pattern: str
    uses: int
    names: tuple[str, ...]  # that joined by it
    anonymous: bool
    expires: int
    at: int
    state: str


class PhoneView(NamedTuple):
    """A passkey."""

    id: bytes
    name: str
    at: int
    last_used: int  # 0: never
    added_by: str  # a phone's name; empty: the terminal
    ended: str  # why; empty: it can approve


class ApprovalView(NamedTuple):
    """An approval: `state` is `waiting` (for the key), `done`, `failed`, or `expired`."""

    id: bytes
    kind: int
    sentence: str
    phone: str
    at: int
    state: str
    result: str


class EventView(NamedTuple):
    """An entry of the log of the record (`ca.store.log_entries.LogEntry`)."""

    number: int
    at: int
    what: str
    subject: str
    detail: str


class DenialView(NamedTuple):
    """A right that a node lacked, as the master or another node refused it."""

    at: int
    node: str
    right: int
    name: str


class FactView(NamedTuple):
    """A fact of the graph, as `rossec.watchGraph` gives it; `kind`: publisher, type and so on."""

    kind: str
    name: str
    node: str


class PolicyRight(NamedTuple):
    """A right that a policy would give or take; `restriction` in words, `until` as its span."""

    node: str
    right: int
    pattern: str
    restriction: str
    until: str


class PolicyView(NamedTuple):
    """The difference between the policy file and the grants in force."""

    path: str
    digest: bytes  # of the file; empty: there is none
    gives: tuple[PolicyRight, ...]
    takes: tuple[PolicyRight, ...]
    keeps: int
    mistakes: tuple[str, ...]
    refused: tuple[str, ...] = ()  # of single nodes: in no grant, though a rule allows it


class PolicyName(NamedTuple):
    """What the policy calls a node, a topic or a pattern; empty: it has no title, or no type."""

    name: str
    title: str
    type: str


class ListStanding(NamedTuple):
    """How far a revocation list has come."""

    epoch: int
    seq: int
    is_signed: bool
    is_at_master: bool
    nodes: int  # with a session at the master; 0: not known
    nodes_with_list: int


class Prepared(NamedTuple):
    """A statement to be approved; `challenge` is its digest, `payload` what it has a digest of."""

    id: bytes
    statement: bytes
    challenge: bytes
    until: int
    rp_id: str
    credentials: tuple[bytes, ...]
    payload: bytes


class Outcome(NamedTuple):
    """What came of an approval: as in `ApprovalView`; `data` is what it made."""

    id: bytes
    state: str
    result: str
    data: bytes  # an identity bundle (PEM), or the text of a join code; empty otherwise


class LoginChallenge(NamedTuple):
    """A challenge for a login, or for a new passkey."""

    id: bytes
    challenge: bytes
    until: int
    rp_id: str
    credentials: tuple[bytes, ...]


class Proposal(NamedTuple):
    """A passkey that waits to be approved by a phone that is there already."""

    id: bytes
    name: str
    digits: str  # shown on both phones
    expires: int
