"""The sites whose facts this master imports, and how their names are written here. Pure.

A site is another master. Names of a foreign domain lie below its label; of another master of the
own domain only the names of nodes do: topics and services of one domain are one namespace. The
mapping itself is `ca.domains.aliases`'s.
"""

from typing import Final, NamedTuple

from ca.domains.aliases import alias_of, check_label, split_alias
from ca.errors import NameRefused
from ca.names import check_name

NODE: Final = "node"
TYPE: Final = "type"
PROVIDER: Final = "provider"


class Site(NamedTuple):
    """Another master.

    Args:
        label: what it is called here; unique.
        domain: the label of its foreign domain; empty: of the own domain.
        on_this_host: it is followed over loopback, so its loopback addresses are this host's.
    """

    label: str
    domain: str = ""
    on_this_host: bool = False

    def check(self) -> "Site":
        """The site, if its labels are valid; raises NameRefused."""
        check_label(self.label)
        if self.domain:
            check_label(self.domain)
        return self

    @property
    def namespace(self) -> str:
        """The label in the aliases of its nodes."""
        return self.domain or self.label

    def node(self, name: str) -> str:
        """The local name of a node of this site; raises NameRefused."""
        return alias_of(self.namespace, name)

    def key(self, name: str) -> str:
        """The local name of a topic or service of this site; raises NameRefused."""
        return alias_of(self.domain, name) if self.domain else check_name(name)

    def origin(self, name: str) -> str | None:
        """The name at this site of what is called `name` here; None: it is not of this site."""
        try:
            alias = split_alias(name)
        except NameRefused:
            return None
        if alias is None:
            return None if self.domain else name
        return alias[1] if alias[0] == self.namespace else None
