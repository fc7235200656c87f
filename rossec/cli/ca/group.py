"""The groups `rossec ca`, and `intermediate`, `invitations` and `log` in it."""

from typing import Final

import click

from rossec.cli.shared.context import Environment
from rossec.cli.shared.lazy import LazyGroup

_CA: Final = {
    "approve": (
        "ca.requests:approve",
        "Approve the request REQUEST_ID (or its beginning), and sign its identity.",
    ),
    "backup": (
        "ca.backup:backup",
        "Write the authority into the new file FILE, encrypted under its passphrase.",
    ),
    "deny": ("ca.requests:deny", "Deny the request REQUEST_ID (or its beginning)."),
    "enroll": (
        "ca.enroll:enroll",
        "Enroll the node that shows CODE: scanned from a picture, or pasted (in single quotes).",
    ),
    "import": (
        "ca.import_identities:import_",
        "Record the identities in BUNDLES (node.pem), which an intermediate enrolled or renewed.",
    ),
    "init": ("ca.init:init", "Create the authority of the trust domain DOMAIN, for example home."),
    "intermediate": (
        "ca.group:intermediate",
        "Let a host sign nodes for a limited time, while the root stays offline.",
    ),
    "invitations": (
        "ca.group:invitations",
        "Show the invitations that can be used, and who joined by them.",
    ),
    "invite": (
        "ca.invite:command",
        "Let nodes whose names PATTERN covers join by a code, without a person for each of them.",
    ),
    "list": ("ca.identities:list_", "List the identities that are valid now."),
    "lock": ("ca.unlock:lock", "Let the running service drop the key at once."),
    "log": ("ca.group:log", "Show everything the authority did, oldest first."),
    "publish": ("ca.revocation:publish", "Give the newest revocation list to the master."),
    "refresh": (
        "ca.revocation:refresh",
        "Sign the revocation list anew, before it expires, and give it to the master.",
    ),
    "renew": (
        "ca.identities:renew",
        "Renew the identity of NAME for the key it has; /ca is the authority's own node.",
    ),
    "requests": (
        "ca.requests:requests",
        "Show the requests for an identity that have no answer yet.",
    ),
    "restore": ("ca.backup:restore", "Prove the backup FILE and put its authority back."),
    "revoke": (
        "ca.revocation:revoke",
        "Revoke the identity of the node NAME, or with --thing the thing NAME, at once.",
    ),
    "serve": (
        "ca.serve:serve",
        "Hold the authority's key, so that commands need no passphrase. Ends with Ctrl-C.",
    ),
    "show": ("ca.identities:show", "Show the authority, or everything about the node NAME."),
    "sign": ("ca.sign:sign", "Sign the identity requests in REQUESTS, after showing them."),
    "status": (
        "ca.unlock:status",
        "Show whether the authority's service runs, and whether it holds the key.",
    ),
    "thing": (
        "ca.things:thing",
        "State that the thing NAME has this key or secret, and which border router serves it.",
    ),
    "things": (
        "ca.things:things",
        "List the things that are stated now, with their border routers.",
    ),
    "unlock": (
        "ca.unlock:unlock",
        "Give the running service the passphrase: it holds the key from now on, for a time.",
    ),
}

_INTERMEDIATE: Final = {
    "install": ("ca.intermediate:install", "On the host: install BUNDLE, which the root signed."),
    "request": (
        "ca.intermediate:request",
        "On the host: make its key and a request, to carry to the root of DOMAIN.",
    ),
    "sign": (
        "ca.intermediate:sign",
        "At the root: sign REQUEST of a host, and set what it may do.",
    ),
}

_INVITATIONS: Final = {
    "revoke": (
        "ca.invitations:revoke",
        "End the invitation INVITATION_ID (or its beginning); who joined by it stays enrolled.",
    ),
}

_LOG: Final = {
    "head": ("ca.log:head", "Sign the state of the log, to be kept elsewhere."),
    "prove": ("ca.log:prove", "Print a proof, as JSON, against the newest signed head (RFC 6962)."),
    "verify": (
        "ca.log:verify",
        "Recompute the whole log and compare it with the record and with every signed head.",
    ),
}


@click.group(cls=LazyGroup, table=_CA)
def ca() -> None:
    """Run the authority, which signs the identities."""


@click.group(cls=LazyGroup, table=_INTERMEDIATE)
def intermediate() -> None:
    """Let a host sign nodes for a limited time, while the root stays offline."""


@click.group(cls=LazyGroup, table=_LOG, invoke_without_command=True)
@click.option("--last", type=click.IntRange(1), help="only the newest so many entries")
@click.option("--json", "in_json", is_flag=True, help="one line of JSON")
@click.pass_context
def log(context: click.Context, last: int | None, in_json: bool) -> None:
    """Show everything the authority did, oldest first."""
    if context.invoked_subcommand is not None:
        return
    from rossec.cli.ca.log import show  # noqa: PLC0415 - imported when it runs

    show(context.ensure_object(Environment), last, in_json=in_json)


@click.group(cls=LazyGroup, table=_INVITATIONS, invoke_without_command=True)
@click.option("--all", "everything", is_flag=True, help="also those that have ended")
@click.option("--json", "in_json", is_flag=True, help="one line of JSON")
@click.pass_context
def invitations(context: click.Context, everything: bool, in_json: bool) -> None:
    """Show the invitations that can be used, and who joined by them."""
    if context.invoked_subcommand is not None:
        return
    from rossec.cli.ca.invitations import show  # noqa: PLC0415 - imported when it runs

    show(context.ensure_object(Environment), everything=everything, in_json=in_json)
