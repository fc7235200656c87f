"""What is signed and in force for a right, whatever the policy says of it today. Pure.

A grant holds until it ends or is revoked: one signed by hand, or before a rule was changed, is used
by its node and accepted by every verifier. So what a policy says is said beside what is in force.
"""

from collections.abc import Collection, Iterable

from ca.domains.aliases import shown
from grants.model import Grant, Right
from grants.policy.decision import Verdict
from grants.policy.patterns import gives, overlaps
from grants.validity import format_time


def in_force(
    grants: Iterable[Grant],
    keys: Collection[bytes],
    right: Right,
    name: str,
    *,
    now: int,
    revoked: Collection[bytes],
) -> list[Grant]:
    """The grants by which a node can use `right` on `name`, or on a part of it, at `now`.

    Args:
        keys: those the node may prove to hold.
        name: a name or a pattern; of a parameter with all that is below it.
        revoked: ids of grants and keys.
    """
    return [
        grant
        for grant in grants
        if grant.holder in keys
        and grant.not_before <= now < grant.expires
        and grant.holder not in revoked
        and not any(entry in revoked for entry in grant.revocable)
        and all(
            any(
                right in each.rights and overlaps(each.pattern, right, name)
                for each in link.permissions
            )
            for link in grant.links
        )
    ]


def lines(found: Iterable[Grant], verdict: Verdict) -> list[str]:
    """What is in force, for people; if the policy does not allow it, that is said."""
    said = held_lines(found, verdict.right, verdict.name)
    if said and not verdict:
        return [*said, "the policy does not allow what these grants still give: apply or revoke"]
    return said


def held_lines(found: Iterable[Grant], right: Right, name: str) -> list[str]:
    """What grants in force give of a right, a line each."""
    return [_line(grant, right, name) for grant in found]


def gives_whole(found: Iterable[Grant], right: Right, name: str) -> bool:
    """Whether one of these grants gives all of `name`, a name or a pattern."""
    return any(
        all(
            any(
                right in each.rights and gives(each.pattern, right, name)
                for each in link.permissions
            )
            for link in grant.links
        )
        for grant in found
    )


def _line(grant: Grant, right: Right, name: str) -> str:
    given = [each for each in grant.permissions if right in each.rights]
    near = [each for each in given if overlaps(each.pattern, right, name)]
    whole = any(gives(each.pattern, right, name) for each in near)
    what = ", ".join(dict.fromkeys(shown(each.pattern) for each in near))
    part = "" if whole else ", a part of it,"
    limited = [each.restriction for each in near if each.restriction is not None]
    how = ", with restrictions" if any(each.restricts_messages for each in limited) else ""
    until = format_time(grant.expires)
    return f"in force: grant {grant.short_id} gives {right.label} {what}{part} until {until}{how}"
