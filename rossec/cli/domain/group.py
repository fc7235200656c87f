"""The group `rossec domain`."""

from typing import Final

import click

from rossec.cli.shared.lazy import LazyGroup

_DOMAIN: Final = {
    "accept": ("domain.accept:accept", "Trust the domain of CARD, as far as these options say."),
    "card": ("domain.card:card", "Write this domain's card, for the authority of another one."),
    "limit": (
        "domain.change:limit",
        "Change how far, and until when, the domain LABEL is trusted.",
    ),
    "list": ("domain.listing:list_", "List the foreign domains that are trusted."),
    "remove": ("domain.change:remove", "Trust the domain LABEL no more, and cut its connections."),
    "show": ("domain.listing:show", "Show how far the domain LABEL is trusted."),
}


@click.group(cls=LazyGroup, table=_DOMAIN)
def domain() -> None:
    """Trust other domains, as far as you say."""
