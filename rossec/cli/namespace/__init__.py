"""`rossec namespace`: names by rules."""

from typing import Final

import click

from rossec.cli.shared.context import LazyGroup

_NAMESPACE: Final = {
    "check": "namespace.serve:check",
    "launch": "namespace.names:launch",
    "messages": "namespace.names:messages",
    "name": "namespace.names:show_name",
    "rules": "namespace.names:show_rules",
    "serve": "namespace.serve:serve",
}


@click.group(cls=LazyGroup, table=_NAMESPACE)
def namespace() -> None:
    """Give names by rules: to a node, its topics and services, from its metadata.

    Names are proposals: nothing is renamed, and no right comes of one.
    """
