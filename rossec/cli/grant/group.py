"""The group `rossec grant`."""

from typing import Final

import click

from rossec.cli.shared.lazy import LazyGroup

_GRANT: Final = {
    "approve": (
        "grant.request:approve",
        "Approve the request REQUEST_ID (or its beginning), as it is or restricted.",
    ),
    "decide": (
        "grant.request:decide",
        "Let the policy decide the requests in REQUEST_FILES and in the inbox.",
    ),
    "deliver": (
        "grant.delivery:deliver",
        "Deposit every grant in force that the master does not have.",
    ),
    "deny": ("grant.request:deny", "Deny the request REQUEST_ID (or the beginning of it)."),
    "install": (
        "grant.signed_grants:install",
        "Give the grant in FILE, or the chain, to its node, on the node's machine.",
    ),
    "list": (
        "grant.delivery:list_",
        "List the grants signed here, of one NODE or of all, and how far each has come.",
    ),
    "narrow": (
        "grant.narrow:narrow",
        "Hand the grant in FILE on to another node of this domain, restricted further.",
    ),
    "pending": ("grant.request:pending", "Show what nodes ask for and the policy leaves to you."),
    "presets": ("grant.sign:presets", "Show what each preset hides, and what it still discloses."),
    "request": ("grant.request:request", "Ask for rights as NODE, on its machine."),
    "revoke": (
        "grant.signed_grants:revoke",
        "Revoke the grant GRANT_ID (or the beginning of it) and notify the master at once.",
    ),
    "show": (
        "grant.signed_grants:show",
        "Show what the grant in FILE allows; its signature is not checked.",
    ),
    "sign": (
        "grant.sign:sign",
        "Let NODE publish, subscribe, call and so on, under conditions and through filters.",
    ),
}


@click.group(cls=LazyGroup, table=_GRANT)
def grant() -> None:
    """Sign, show and revoke grants."""
