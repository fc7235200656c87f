"""`rossec privacy opt-out`: show a topic to no node, or no topic to a node."""

import secrets
import time
from dataclasses import replace
from pathlib import Path

import click

from grants import document
from grants.model import Draft, Grant, Permission, Right
from grants.names import check_pattern
from grants.policy.editing import NewRule, add_rules, free_id
from grants.policy.patterns import intersects
from rossec.authority.home import AuthorityHome
from rossec.authority.signing import SigningAuthority
from rossec.cli.shared import options, passphrase
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.delivery import publish_list
from rossec.cli.shared.grant_delivery import deliver_grant
from rossec.cli.shared.policy import read_policy
from rossec.terminal import say


@click.command("opt-out")
@click.argument("name")
@click.option("--node", "is_node", is_flag=True, help="NAME is a node, enrolled or not")
@options.master_uri
@options.policy
@passphrase.option
@pass_environment
def opt_out(
    environment: Environment,
    name: str,
    is_node: bool,
    master_uri: str | None,
    policy_path: Path | None,
    passphrase_file: Path | None,
) -> None:
    """Show the topic NAME to no node; or, when NAME is a node, show that node no topic.

    Adds a denial to the policy and revokes what was granted. Running connections end at once.
    What else the revoked grants allowed is granted anew.
    """
    check_pattern(name)
    read = read_policy(environment, policy_path)
    home = AuthorityHome.at(environment.home)
    store = home.store()
    known = name in {row.name for row in store.certificates()}
    store.close()
    node = name if is_node or known else None
    authority = home.unlock(passphrase.read(passphrase_file, environment.variables))
    rule = _denial(name, node, [item.id for item in read.policy.rules])
    read = read.replace(add_rules(read.text, [rule]))
    say(f"rule {rule.id} in {read.path} denies it from now on")
    # With the record locked: a decision by the old policy is signed already, or cannot be.
    with authority.store.transaction():
        affected = [grant for grant in _live(authority) if _shows(grant, name, node)]
        reissued = [
            (grant.subject, _revoke_and_reissue(authority, grant, name, node)) for grant in affected
        ]
    for subject, data in reissued:
        if data is not None:
            say(f"its other rights are grant {document.grant_id(data).hex()}")
            deliver_grant(environment, subject, data, None)
    if affected:
        publish_list(environment, master_uri)


def _revoke_and_reissue(
    authority: SigningAuthority, grant: Grant, name: str, node: str | None
) -> bytes | None:
    """Revoke `grant`; returns what gives its holder the other rights, signed, if there are any."""
    authority.revoke(grant.id, f"opted out of {name}", now())
    say(f"revoked grant {grant.id.hex()} of {grant.subject}")
    remaining = _remaining(grant, name, node)
    return None if remaining is None else authority.issue_grant(remaining, now())


def _denial(name: str, node: str | None, taken: list[str]) -> NewRule:
    day = time.strftime("%Y-%m-%d", time.gmtime(now()))
    prefix = "opt-out" + name.replace("/", "-").replace("*", "any")[:60]
    rights = {"subscribe": ["/**" if node is not None else name]}
    return NewRule(free_id(taken, prefix), f"opted out {day}", node or "*", "deny", rights)


def _live(authority: SigningAuthority) -> list[Grant]:
    """Every grant that holds, or will."""
    revoked = authority.store.revoked_entries()
    grants = [document.peek(row.data) for row in authority.store.grants()]
    return [
        grant
        for grant in grants
        if revoked.isdisjoint((grant.id, grant.holder)) and now() < grant.cap
    ]


def _shows(grant: Grant, name: str, node: str | None) -> bool:
    if node is not None and grant.subject != node:
        return False
    return any(_permits(permission, name, node) for permission in grant.permissions)


def _permits(permission: Permission, name: str, node: str | None) -> bool:
    seen = Right.SUBSCRIBE in permission.rights
    return seen and (node is not None or intersects(permission.pattern, name))


def _remaining(grant: Grant, name: str, node: str | None) -> Draft | None:
    """What `grant` allows besides, as a new draft; None when that is nothing or over."""
    permissions: list[Permission] = []
    for item in grant.permissions:
        rights = item.rights & ~Right.SUBSCRIBE if _permits(item, name, node) else item.rights
        if rights:
            permissions.append(replace(item, rights=rights))
    if not permissions or grant.expires <= now():
        return None
    return Draft(
        grant.domain, grant.subject, grant.holder, grant.not_before, grant.expires, grant.cap,
        secrets.token_bytes(16), tuple(permissions),
    )  # fmt: skip
