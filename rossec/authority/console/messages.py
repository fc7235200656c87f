"""Requests of the console and their answers. Pure; frames and refusals are those of `keyservice`.

The table is all that the console can ask. Nothing in it signs what was not approved: `PREPARE`
makes a statement, `APPROVE` verifies a passkey's signature over its digest and only then acts. What
only takes away (`deny-*`, `revoke-*`, `end-*`, `remove-phone`) needs none.
"""

from collections.abc import Mapping
from typing import Final

from ca.encoding import Value
from rossec.authority.keyservice import messages
from rossec.authority.keyservice.messages import Request
from rossec.errors import KeyMessageRefused, KeyServiceRefused
from rossec.files import Owned

SOCKET: Final = "console.sock"  # in the authority's directory
# What the console has there. Who restores an authority makes a new TLS key for browsers.
DIRECTORY: Final = "console"
ADDRESS: Final = f"{DIRECTORY}/address"
LOCK: Final = f"{DIRECTORY}/lock"
TLS_KEY: Final = "tls.key"
TLS_CERTIFICATE: Final = "tls.pem"
OWNED: Final = (
    Owned(rf"{DIRECTORY}/(?:address|lock)", kept=False),
    Owned(rf"{DIRECTORY}/tls\.(?:key|key\.[0-9a-f]{{16}}|pem)", kept=False),
)
MAX_REQUEST: Final = 64 * 1024
MAX_ANSWER: Final = 4 * 1024 * 1024

# Kinds of `PREPARE`, with the types of their arguments; the numbers are those of the statements.
PREPARED: Final[Mapping[str, tuple[type, ...]]] = {
    "enroll": (bytes, str, bool, int, bool),  # csr, source, anonymous, lifetime, replaces the key
    "grant": (bytes, str, int),  # question, coarse filter ("" for none), seconds (0: as asked)
    "policy": (bytes,),  # digest of the file, as shown
    "delegate": (int, int),  # lifetime, longest time of a renewed grant
    "intermediate": (bytes, bool, int),  # csr, may enroll, lifetime
    "passkey": (bytes,),  # proposal
    "invitation": (str, int, int, bool),  # pattern, uses, seconds, anonymous
    "revoke-master": (str, str),  # reason, which master
}

OPERATIONS: Final[Mapping[str, tuple[type, ...]]] = {
    # reading; the answer in brackets
    "status": (),  # Status
    "nodes": (),  # [NodeView]
    "grants": (),  # [GrantView]: in force, and those that ended within 30 days
    "identity-requests": (),  # [IdentityRequestView]
    "questions": (),  # [GrantQuestion]
    "consider": (bytes, str, int),  # as "grant" below: [AskedRight] that would be granted
    "question-answers": (bytes,),  # id: [QuestionAnswer], none while it waits
    "invitations": (),  # [InvitationView]
    "phones": (),  # [PhoneView]
    "proposals": (),  # [Proposal]
    "approvals": (int,),  # [ApprovalView], newest first, at most so many
    "events": (int, int),  # before this number (0: the newest), at most so many: [EventView]
    "denials": (),  # [DenialView] of the last day, newest first; raises if there is no master
    "graph": (),  # [FactView]; raises if there is no master
    "policy": (),  # PolicyView
    "policy-names": (),  # [PolicyName]: titles and types
    "standing": (int, int),  # epoch, seq: ListStanding
    # taking away; a list number [epoch, seq], [0, 0] while the key is locked
    "deny-request": (bytes, str),  # id, reason: nothing
    "deny-question": (bytes, str),  # id, reason: nothing
    "revoke-grant": (bytes, str),  # id, reason: [epoch, seq]
    "revoke-node": (str, str),  # name, reason: [epoch, seq]; not of a master
    "end-invitation": (bytes, str),  # id, reason: nothing
    "remove-phone": (bytes, str),  # id, reason: nothing
    "end-proposal": (bytes,),  # id of a phone that waits: nothing
    # approving
    "prepare": (str, list, str),  # kind, arguments as in PREPARED, for whom (`owners`): Prepared
    "approve": (bytes, bytes, bytes, bytes, bytes),
    # id, credential, client data, authenticator data, signature: Outcome
    "outcome": (bytes,),  # id: Outcome
    # who looks: the console's own sessions follow from these
    "login-challenge": (str,),  # origin: LoginChallenge
    "login": (bytes, bytes, bytes, bytes, bytes),  # as "approve": the phone's name
    "redeem": (str,),  # a code from the terminal, used up by this: None; looks, approves nothing
    "new-passkey": (str, str),  # origin, rp id: LoginChallenge, for `navigator.credentials.create`
    "add-passkey": (bytes, str, str, bytes, bytes),
    # challenge id, code from the terminal, name, client data, attestation object: PhoneView
    "propose-passkey": (bytes, str, str, bytes, bytes),  # as above, code of "phone-link": Proposal
    "phone-link": (str,),  # for whom: a one-time code for "propose-passkey", text
}


def read_request(body: bytes) -> Request:
    """Read the body of a request's frame.

    Raises:
        KeyMessageRefused: malformed, or not in the tables above.
    """
    request = messages.read_request(body, OPERATIONS, MAX_REQUEST)
    match request:
        case Request("prepare", (str() as kind, list() as arguments, str())) if tuple(
            map(type, arguments)
        ) != PREPARED.get(kind):
            raise KeyMessageRefused(f"{kind[:40]!a} is not prepared with such arguments", _HINT)
    return request


def checked(answer: Value) -> Value:
    """The answer, if it is one that the console reads.

    Raises:
        KeyServiceRefused: it is too long.
    """
    if len(messages.write_answer(answer)) > MAX_ANSWER:
        raise KeyServiceRefused(
            f"the answer has more than {MAX_ANSWER} bytes", "use the commands of the authority"
        )
    return answer


_HINT: Final = "are the service and the console of one version of rossec?"
