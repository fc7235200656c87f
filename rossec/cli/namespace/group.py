"""The group `rossec namespace`, which gives names by rules."""

from typing import Final

import click

from rossec.cli.shared.lazy import LazyGroup

_NAMESPACE: Final = {
    "check": (
        "namespace.check:check",
        "Try RULES on the metadata of many nodes: which names are wrong, and why.",
    ),
    "launch": (
        "namespace.launch:launch",
        "Write the launch file IN.launch again, with names that rules give in place of metadata.",
    ),
    "messages": (
        "namespace.messages:command",
        "Write the package rossec_namespace into DIRECTORY: the type of the service.",
    ),
    "name": ("namespace.name:name", "Show the name that rules give for the metadata in META."),
    "rules": ("namespace.show_rules:command", "Print the rules that are shipped, to be changed."),
    "serve": (
        "namespace.serve:serve",
        "Answer nodes that ask which name a topic or service of theirs gets.",
    ),
}


@click.group(cls=LazyGroup, table=_NAMESPACE)
def namespace() -> None:
    """Give names by rules: to a node, its topics and services, from its metadata.

    Names are proposals: nothing is renamed, and no right comes of one.
    """
