"""What was approved, as one line for people. Pure."""

from collections.abc import Iterable
from typing import Final

from ca.approvals import statement as kinds
from ca.approvals.statement import Statement
from ca.encoding import Value, decode
from ca.errors import EncodingError
from ca.names import MASTER
from grants import claims
from grants.errors import GrantError
from grants.model import ID_SIZE, Permission
from rossec.clock import format_duration, format_time
from rossec.ros.text import printable

_MOST: Final = 4  # rights that are listed


def sentence(statement: Statement, payload: bytes) -> str:
    """What `statement` is about; `payload` is what it has a digest of."""
    match statement.what:
        case kinds.Enroll(name=name, replaces=replaces):
            text = f"identity of {name}" + ", with another key than before" * replaces
        case kinds.Grant():
            text = given(_bodies(payload))
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


def given(bodies: Iterable[bytes]) -> str:
    """What grants with these claims give, and until when: what was approved, not what was asked."""
    try:
        found = [claims.read(body, bytes(ID_SIZE)) for body in bodies]
    except (EncodingError, GrantError):
        found = []
    if not found:
        return "a right of a node"
    rights = dict.fromkeys(_right(each) for grant in found for each in grant.permissions)
    more = f" and {len(rights) - _MOST} more" if len(rights) > _MOST else ""
    until = format_time(min(max(each.expires, each.cap) for each in found))
    return f"{found[0].subject} may {', '.join([*rights][:_MOST])}{more}, until {until}"


def _right(given: Permission) -> str:
    coarser = given.restriction is not None and given.restriction.restricts_messages
    return f"{given.rights.label} {given.pattern}" + " (not all of it)" * coarser


def _bodies(payload: bytes) -> list[bytes]:
    """The claims in the payload of a grant (`grant_acts`); none if it is malformed."""
    try:
        match decode(payload, limit=kinds.MAX_PAYLOAD):
            case [_, _, [*grants]]:
                return [body for grant in grants for body in _body(grant)]
            case _:
                pass
    except EncodingError:
        pass
    return []


def _body(grant: Value) -> list[bytes]:
    match grant:
        case [bytes(body), _]:
            return [body]
        case _:
            return []
