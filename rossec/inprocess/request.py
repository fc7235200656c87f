"""`rossec.ask`: the running program requests a right, and waits for it or goes on.

The request is signed with the node's key. It lands in the inbox of an authority in the same
ROSSEC_HOME; with the authority elsewhere, in the node's directory `requests/`, to be carried there.
When the grant arrives, what the master had refused for want of it is registered by itself.
"""

import secrets
import time
from pathlib import Path
from typing import Final

from grants.model import Right
from grants.request import GrantRequest, RequestedRight, sign_request
from rossec import files
from rossec.authority import requests
from rossec.errors import ConfigurationError
from rossec.inprocess.identity import LocalIdentity, now
from rossec.inprocess.secure import secured

_LOOK: Final = 0.1  # seconds


def ask(right: str, name: str, *, why: str, wait: float = 0.0) -> bool:
    """Request `right` on `name`, unless this node has it; whether it has it after `wait` seconds.

    Args:
        right: `subscribe`, `publish`, `call`, `provide`, `param-get` or `param-set`.
        name: an absolute name or pattern.
        why: the reason, for the person or the policy that decides.
        wait: how long to wait for the answer; 0: go on.

    Raises:
        ConfigurationError: not secured, without a name yet, or no such right.
        GrantError: not a pattern, or a reason that is too long.
    """
    member = secured().member
    wanted = _right(right)
    if not member.access.holds(wanted, name, now()):
        _send(member, wanted, name, why)
    end = time.monotonic() + wait
    while not (held := member.access.holds(wanted, name, now())) and time.monotonic() < end:
        time.sleep(_LOOK)
    return held


def _right(label: str) -> Right:
    try:
        return Right[label.upper().replace("-", "_")]
    except KeyError:
        known = ", ".join(one.label for one in Right)
        raise ConfigurationError(f"there is no right {label!r}", f"rights are {known}") from None


def _send(member: LocalIdentity, right: Right, name: str, why: str) -> None:
    request = GrantRequest(
        member.identity.domain, member.identity.name, now(), secrets.token_bytes(16),
        (RequestedRight(right, name),), why,
    )  # fmt: skip
    data = sign_request(member.credentials.signer, request)
    authority = _authority_of(member)
    if (authority / "ca.pem").exists():
        requests.lay(authority, request, data)
        return
    folder = member.home.path / "requests"
    files.make_private_directory(folder)
    files.replace(folder / f"{request.id.hex()}.request", data)


def _authority_of(member: LocalIdentity) -> Path:
    return member.home.path.parent.parent / "ca"
