"""Whether a grant is the caller's own: by its key, its domain and its name. Pure."""

from grants.errors import GrantNotHeld
from grants.model import Grant
from grants.narrowing import check_one_domain
from grants.tail import check_tail
from rossec.master.rights.caller import Caller


def check_holder(caller: Caller, grant: Grant, label: str) -> None:
    """Return if `grant`, which is verified, is one of the caller's.

    Args:
        label: what the domain of the grant is called here; empty: it is the own one.

    Raises:
        GrantNotHeld: it is bound to another key, or for the anonymous nodes of another identity.
        NarrowingOutsideDomain: it was handed to another domain.
    """
    if grant.holder != caller.thumbprint:
        raise GrantNotHeld("the grant is bound to another key", f"it was issued to {grant.subject}")
    name = caller.certified or caller.name
    check_one_domain(grant, label, name)
    check_tail(grant, name, tail=caller.has_tail)
