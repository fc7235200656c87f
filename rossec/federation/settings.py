"""Which masters to follow: one entry for each, checked. Pure.

A label is given once, and never is that of a foreign domain but where the master is one of it: the
labels of masters of the own domain and of foreign domains name the same thing in `/remote/<label>`.
"""

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Final

from ca.domains.aliases import check_label
from ca.errors import NameRefused
from ca.names import MASTER, is_master_name
from ca.patterns import check_pattern
from rossec.errors import ConfigurationError
from rossec.master.state.sites import Site
from rossec.ros.settings import is_loopback, parse_uri

MAX_SITES: Final = 64
MAX_PARAMETERS: Final = 64  # patterns of one site
MAX_FILE: Final = 64 * 1024
_FORM: Final = 1


@dataclass(frozen=True)
class SiteSettings:
    """A master to follow.

    Args:
        label: what it is called here.
        uri: where it listens; empty: it is reached by a relay.
        master: the name it is certified for.
        domain: the label of its foreign domain; empty: it is of the own domain.
        parameters: patterns of the parameters to mirror, with the names they have there.
        via: the label that the relay of this site has for the peer behind which the master is.

    Raises:
        ConfigurationError: one of them is not in form.
    """

    label: str
    uri: str
    master: str = MASTER
    domain: str = ""
    parameters: tuple[str, ...] = ()
    via: str = ""

    def __post_init__(self) -> None:
        try:
            check_label(self.label)
            for label in filter(None, (self.domain, self.via)):
                check_label(label)
            for pattern in self.parameters:
                check_pattern(pattern)
        except NameRefused as error:
            raise ConfigurationError(str(error), error.hint) from error
        if not is_master_name(self.master):
            raise ConfigurationError(
                f"{self.master[:255]!a} is not the name of a master", "/master, or /master/kitchen"
            )
        if len(self.parameters) > MAX_PARAMETERS:
            raise ConfigurationError(f"at most {MAX_PARAMETERS} patterns of parameters for a site")
        if bool(self.via) == bool(self.uri):
            raise ConfigurationError(
                f"site {self.label} has a URI or a relay's peer, one of them", _WAYS
            )
        if self.uri:
            parse_uri(self.uri, "the master's URI")

    @property
    def site(self) -> Site:
        """The site for the import layer; a relay's doors may be on this host."""
        return Site(self.label, self.domain, bool(self.via) or is_loopback(self.address[0]))

    @property
    def address(self) -> tuple[str, int]:
        """Host and port; of a site without a relay."""
        return parse_uri(self.uri, "the master's URI")

    @property
    def place(self) -> str:
        """Where it is, for people."""
        return f"via {self.via}" if self.via else f"at {self.uri}"


def checked_sites(sites: Iterable[SiteSettings]) -> dict[str, SiteSettings]:
    """The sites by label.

    Raises:
        ConfigurationError: a label or a master is there twice, or there are too many.
    """
    found: dict[str, SiteSettings] = {}
    for each in sites:
        if each.label in found:
            raise ConfigurationError(
                f"two sites are called {each.label}", "give each its own label"
            )
        for other in found.values():
            if (other.domain, other.master) == (each.domain, each.master):
                raise ConfigurationError(
                    f"{other.label} and {each.label} are one master, {each.master}",
                    "follow it once",
                )
        found[each.label] = each
    domains = {each.domain for each in found.values() if each.domain}
    if twice := sorted({each.label for each in found.values() if not each.domain} & domains):
        raise ConfigurationError(
            f"{twice[0]} is the label of a foreign domain", "give the own master another one"
        )
    if len(found) > MAX_SITES:
        raise ConfigurationError(f"at most {MAX_SITES} sites can be followed")
    return found


def read_sites(data: bytes, name: str) -> dict[str, SiteSettings]:
    """Read the file that `rossec federation add` writes, called `name`; a closed schema.

    Raises:
        ConfigurationError: anything else.
    """
    if len(data) > MAX_FILE:
        raise ConfigurationError(f"{name} is longer than {MAX_FILE} bytes")
    try:
        found = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise ConfigurationError(f"{name} is not JSON", _HINT) from error
    match found:
        case {"rossec-federation": 1, "sites": list() as rows, **rest} if not rest:
            return checked_sites(_site(row, name) for row in rows)
        case _:
            raise ConfigurationError(f"{name} is not a list of sites of this form", _HINT)


def write_sites(sites: Mapping[str, SiteSettings]) -> bytes:
    """The content of the file."""
    rows = [_row(each) for _, each in sorted(sites.items())]
    return json.dumps({"rossec-federation": _FORM, "sites": rows}, indent=1).encode() + b"\n"


def _row(site: SiteSettings) -> dict[str, object]:
    """A site without a relay is written as it was before there were relays."""
    row = {**asdict(site), "parameters": list(site.parameters)}
    return row if site.via else {key: value for key, value in row.items() if key != "via"}


def _site(row: object, name: str) -> SiteSettings:
    match row:
        case {
            "label": str() as label, "uri": str() as uri, "master": str() as master,
            "domain": str() as domain, "parameters": list() as patterns, **rest,
        } if rest.keys() <= {"via"} and isinstance(via := rest.get("via", ""), str):  # fmt: skip
            texts = tuple(each for each in patterns if isinstance(each, str))
            if len(texts) == len(patterns):
                return SiteSettings(label, uri, master, domain, texts, via)
    raise ConfigurationError(f"{name} has a site that is not in form", _HINT)


_WAYS: Final = "uri: http://kitchen:11311, or via: office, a peer of: rossec relay list"
_HINT: Final = "it is written by `rossec federation add`, `remove` and `param`: use these"
