"""The group `rossec federation`."""

from typing import Final

import click

from rossec.cli.shared.lazy import LazyGroup

_FEDERATION: Final = {
    "add": (
        "federation.sites:add",
        "Follow the master at URI, or behind the relay's peer PEER, and call it LABEL.",
    ),
    "list": (
        "federation.sites:list_",
        "List the masters to follow, as `rossec federation add` has them.",
    ),
    "param": (
        "federation.sites:param",
        "Mirror the parameters of LABEL that match PATTERN, read-only.",
    ),
    "remove": ("federation.sites:remove", "Follow LABEL no longer: its names go at once."),
    "status": (
        "federation.status:status",
        "Show how far each master is followed; the own one must have been started with --admin.",
    ),
}


@click.group(cls=LazyGroup, table=_FEDERATION)
def federation() -> None:
    """Follow other masters: of the own domain, and of domains that are trusted.

    For the master on this host; with several, that of ROSSEC_MASTER.
    """
