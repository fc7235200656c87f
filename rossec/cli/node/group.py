"""The group `rossec node`: what is done on the machine of a node."""

from typing import Final

import click

from rossec.cli.shared.lazy import LazyGroup

_NODE: Final = {
    "code": (
        "node.identity:code",
        "Show the QR code of NAME's request, for the authority to scan.",
    ),
    "confirm": (
        "node.enroll:confirm",
        (
            "Confirm that the authority shows DIGITS for NAME,"
            " whose enrollment waits in another process."
        ),
    ),
    "enroll": (
        "node.enroll:enroll",
        "Enroll the node NAME: show its code, wait for the authority, and for your confirmation.",
    ),
    "info": (
        "node.running_nodes:info",
        "Show what the running node NAME publishes, subscribes to and provides.",
    ),
    "install": (
        "node.identity:install",
        "Install the signed identity in BUNDLE, and trust the authority that signed it.",
    ),
    "join": (
        "node.join:command",
        "Join a site by an invitation: make the key, prove the code, install the identity.",
    ),
    "labels": (
        "node.enroll:labels",
        "Write a sheet of labels for the nodes NAMES, 24 to a page; makes keys that are missing.",
    ),
    "list": ("node.running_nodes:list_", "List the running nodes that NODE may see."),
    "request": (
        "node.identity:request",
        "Make the key of the node NAME and a request for its identity.",
    ),
    "show": ("node.identity:show", "Show the identity of NAME and how many grants it holds."),
}


@click.group(cls=LazyGroup, table=_NODE)
def node() -> None:
    """Prepare a node on its own machine."""
