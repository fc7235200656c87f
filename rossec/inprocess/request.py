"""`rossec.ask`: the running program requests a right, and waits for it or continues.

When the grant arrives, registrations that the master had refused are repeated.
"""

import secrets
import time
from typing import Final

from ca.names import is_alias, origin_of, shown
from grants.model import Right
from grants.request import GrantRequest, RequestedRight, sign_request
from rossec import files
from rossec.authority import requests
from rossec.errors import ConfigurationError
from rossec.inprocess.identity import LocalIdentity, now
from rossec.inprocess.secure import secured
from rossec.participant.access import possible_names

_POLL_INTERVAL: Final = 0.1  # seconds


def ask(right: str, name: str, *, why: str, wait: float = 0.0) -> bool:
    """Request `right` on `name`, unless this node has it; whether it has it after `wait` seconds.

    Args:
        right: `subscribe`, `publish`, `call`, `provide`, `param-get` or `param-set`.
        name: an absolute name or pattern.
        why: the reason, for the person or the policy that decides.
        wait: how long to wait for the answer; 0: do not wait.
    """
    local_identity = secured().local_identity
    try:
        wanted = Right[right.upper().replace("-", "_")]
    except KeyError:
        known = ", ".join(one.label for one in Right)
        raise ConfigurationError(f"there is no right {right!r}", f"rights are {known}") from None
    if not local_identity.access.holds(wanted, name, now()):
        if is_alias(name) and wanted is not Right.GRAPH:
            # Only the origin's authority gives rights on its names, and it takes no request from here.
            served = possible_names(name)[1:] if wanted is Right.SUBSCRIBE else ()
            raise ConfigurationError(
                f"rights on {shown(name)} are given by the authority of that domain",
                f"there: rossec grant sign LABEL:{local_identity.name} --{wanted.label} {origin_of(name)}"
                " --certificate FILE"
                + "".join(f"; or ask for {each}, if a gateway here serves it" for each in served),
            )
        _send(local_identity, wanted, name, why)
    end = time.monotonic() + wait
    while not (held := local_identity.access.holds(wanted, name, now())) and time.monotonic() < end:
        time.sleep(_POLL_INTERVAL)
    return held


def _send(local_identity: LocalIdentity, right: Right, name: str, why: str) -> None:
    request = GrantRequest(
        local_identity.identity.domain,
        local_identity.identity.name,
        now(),
        secrets.token_bytes(16),
        (RequestedRight(right, name),),
        why,
    )
    data = sign_request(local_identity.credentials.signer, request)
    # Into the inbox of an authority in the same ROSSEC_HOME; if it is elsewhere, into a directory of the
    # node's, to be copied there.
    authority = local_identity.home.path.parent.parent / "ca"
    if (authority / "ca.pem").exists():
        requests.put_in_inbox(authority, request, data)
        return
    folder = local_identity.home.path / "requests"
    files.make_private_directory(folder)
    files.replace(folder / f"{request.id.hex()}.request", data)
