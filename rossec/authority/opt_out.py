"""Opting out: deny a topic to all nodes, or all topics to a node, and revoke what shows them.

The policy is changed first. The grants are then revoked with the record locked: a decision by the
old policy is signed already, or cannot be (`ApprovalQueue.sign`). What else they allowed is granted
anew, with the same times.
"""

import secrets
import time
from dataclasses import replace
from typing import NamedTuple

from grants import document
from grants.model import Draft, Grant, Permission, Right
from grants.policy.editing import NewRule, add_rules, free_id
from grants.policy.patterns import intersects
from rossec.authority.policyfile import PolicyFile
from rossec.authority.signing import SigningAuthority


class OptOut(NamedTuple):
    """A denial in the policy: of the topic `name`, or of all topics to the node `name`."""

    policy: PolicyFile
    rule: str
    name: str
    is_node: bool

    def denies(self, permission: Permission) -> bool:
        """Whether the permission shows what is denied."""
        shows = Right.SUBSCRIBE in permission.rights
        return shows and (self.is_node or intersects(permission.pattern, self.name))

    def affects(self, grant: Grant) -> bool:
        """Whether the grant shows what is denied."""
        concerns = not self.is_node or grant.subject == self.name
        return concerns and any(self.denies(permission) for permission in grant.permissions)


def add_denial(policy: PolicyFile, name: str, now: int, *, is_node: bool) -> OptOut:
    """Write the denial into the policy; see `PolicyFile.replace`."""
    day = time.strftime("%Y-%m-%d", time.gmtime(now))
    prefix = "opt-out" + name.replace("/", "-").replace("*", "any")[:60]
    rule = NewRule(
        free_id([item.id for item in policy.policy.rules], prefix), f"opted out {day}",
        name if is_node else "*", "deny", {"subscribe": ["/**" if is_node else name]},
    )  # fmt: skip
    return OptOut(policy.replace(add_rules(policy.text, [rule])), rule.id, name, is_node)


def revoke_shown(
    authority: SigningAuthority, opted_out: OptOut, now: int
) -> list[tuple[Grant, bytes | None]]:
    """Revoke all grants that hold, or will, and show what is denied; or, if one fails, none.

    They are returned with the signed grants of their other rights, where there are any.
    """
    store = authority.store
    with store.transaction():
        revoked, rules = store.revoked_entries(), store.policy_grants()
        grants = [document.peek(row.data) for row in store.grants()]
        return [
            (grant, _revoke(authority, grant, opted_out, now, rules.get(grant.id, "")))
            for grant in grants
            if revoked.isdisjoint((grant.id, grant.holder)) and now < grant.cap
            and opted_out.affects(grant)
        ]  # fmt: skip


def _revoke(
    authority: SigningAuthority, grant: Grant, opted_out: OptOut, now: int, rules: str
) -> bytes | None:
    """Revoke `grant`; returns what gives its holder the other rights, signed, if there are any."""
    authority.revoke(grant.id, f"opted out of {opted_out.name}", now)
    permissions: list[Permission] = []
    for item in grant.permissions:
        rights = item.rights & ~Right.SUBSCRIBE if opted_out.denies(item) else item.rights
        if rights:
            permissions.append(replace(item, rights=rights))
    if not permissions or grant.expires <= now:
        return None
    draft = Draft(
        grant.domain, grant.subject, grant.holder, grant.not_before, grant.expires, grant.cap,
        secrets.token_bytes(16), tuple(permissions),
    )  # fmt: skip
    return authority.issue_grant(draft, now, rules)
