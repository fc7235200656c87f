"""What was approved, as one line for people. Pure."""

from ca.approvals import statement as kinds
from ca.approvals.statement import Statement
from ca.encoding import decode
from ca.errors import EncodingError
from ca.names import MASTER
from grants import claims
from grants.errors import GrantError
from grants.model import ID_SIZE
from rossec.clock import format_duration
from rossec.ros.text import printable


def sentence(statement: Statement, payload: bytes) -> str:
    """What `statement` is about; `payload` is what it has a digest of."""
    match statement.what:
        case kinds.Enroll(name=name, replaces=replaces):
            text = f"identity of {name}" + ", with another key than before" * replaces
        case kinds.Grant():
            text = f"what {_holder(payload)} asked for"
        case kinds.PolicyChange():
            text = "the changed policy is in force"
        case kinds.Delegate(lifetime=lifetime):
            text = f"the master may renew grants for {format_duration(lifetime)}"
        case kinds.Intermediate(enrolls=enrolls):
            new = "and enroll nodes" if enrolls else "for nodes known here"
            text = f"an intermediate authority may renew identities {new}"
        case kinds.NewPasskey(name=name):
            text = f"phone {name}"
        case kinds.Invitation(pattern=pattern, uses=uses):
            text = f"join code for {uses} of {pattern}"
        case kinds.RevokeMaster(reason=reason, master=master):
            which = "the master" if master == MASTER else f"the master {master}"
            text = f"revocation of {which}" + f": {reason}" * bool(reason)
        case _:
            text = "another domain"
    return printable(text)


def _holder(payload: bytes) -> str:
    """The node in the payload of a grant (`grant_acts`)."""
    try:
        match decode(payload, limit=kinds.MAX_PAYLOAD):
            case [_, _, [[bytes(body), _], *_]]:
                return claims.read(body, bytes(ID_SIZE)).subject
            case _:
                pass
    except (EncodingError, GrantError):
        pass
    return "a node"
