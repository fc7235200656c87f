"""Tail patterns in grants: rights on the names of the anonymous nodes of one identity.

A grant to `/rviz` may say `/rviz~/get_loggers`: for `/rviz` and for each name that its wildcard
tail covers (ADR 0007). The form of a grant allows it only about the grant's own subject
(`grants.model`). Here is the other half: such a grant counts only while the peer proves, by its
certificate, that it is this node and has the tail. Without one, names beside its own could be
certified for other keys.
"""

from grants.errors import GrantNotHeld
from grants.model import Grant


def check_tail(grant: Grant, peer: str, *, tail: bool) -> None:
    """Return if `grant` has no tail patterns, or the peer has the tail they are about.

    Args:
        peer: the certified name of the peer, an alias if it is a foreigner.
        tail: whether its certificate has a wildcard tail, which that of a foreigner never has here.

    Raises:
        GrantNotHeld: the names in it are not the peer's. A chain with tail patterns is refused.
    """
    if not any(link.has_tail_patterns for link in grant.links):
        return
    if grant.chain or not tail or grant.subject != peer:
        raise GrantNotHeld(
            f"grant {grant.short_id} is for the anonymous nodes of {grant.subject}",
            f"its certificate must have a wildcard tail: rossec ca sign FILE --anonymous, and for"
            f" {grant.subject} itself a grant of its own",
        )
