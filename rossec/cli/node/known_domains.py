"""What a node knows of foreign domains, and whether that is the newest: for `rossec doctor`.

A node without a list knows none, which is in order unless an authority on this machine has one.
"""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from ca.certificates import TrustAnchor
from ca.domains.lists import DomainList
from ca.errors import HintedError
from rossec.authority.home import AuthorityHome
from rossec.clock import format_time
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.saved_domains import DomainFiles


def check_domains(home: Path, node: NodeHome, now: int) -> Iterator[str]:
    """A line for each domain that the node trusts.

    Raises:
        ConfigurationError: its list has expired, or is not the newest of this machine.
        DomainsRefused: its list is not the authority's.
    """
    anchor = node.anchor()
    held, newest = DomainFiles(node, anchor).anchors().current, _recorded(home, anchor)
    for each in () if held is None else held.domains:
        ended = "" if now < each.until else ", which is over"
        until = format_time(each.until)
        yield f"admits nodes of {each.domain}, here {each.label}, until {until}{ended}"
    if held is not None and now >= held.expires:
        raise ConfigurationError(
            "the list of domains has expired: no foreign node is admitted",
            "at the authority: rossec ca refresh",
        )
    if newest is not None and (held is None or held.number < newest.number):
        raise ConfigurationError(
            "the node has not the newest list of domains",
            "deliver it: rossec ca publish; the node takes it from the master while it runs",
        )


def _recorded(home: Path, anchor: TrustAnchor) -> DomainList | None:
    """The newest list of an authority on this machine, if it is the node's."""
    with suppress(HintedError):
        authority = AuthorityHome.at(home)
        if authority.anchor().thumbprint == anchor.thumbprint:
            found = authority.domain_list()
            return None if found is None else found[1]
    return None
