"""Files with a grant or a chain of narrowings, as the commands of a node read them.

A grant of the node's own domain, or of a listed one, is verified. Of one of another domain that is
checked which the node can know: its form, its time and its key.
"""

from pathlib import Path

from ca.domains.aliases import origin_of, shown
from grants.errors import GrantNotHeld
from grants.model import Grant
from grants.token import MAX_TOKEN, Verifier, peek
from grants.validity import check_time
from rossec import files
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.saved_domains import DomainFiles


def read_token(path: Path) -> bytes:
    """The octets of a file with a token; not verified.

    Raises:
        ConfigurationError: it is gone, or too large.
    """
    missing = ConfigurationError(f"there is no file {path}", "give the file `rossec grant` wrote")
    return files.read(path, MAX_TOKEN, missing)


def holder_home(rossec_home: Path, grant: Grant) -> NodeHome:
    """The directory of the node a grant is for: a grant of another domain names it by its alias."""
    return NodeHome.of(rossec_home, origin_of(grant.subject))


def open_held(home: NodeHome, token: bytes, now: int) -> Grant:
    """What a token of this node says, verified as far as this node can.

    Raises:
        GrantError: the subclass for what is wrong.
    """
    anchor, grant = home.anchor(), peek(token)
    listed = DomainFiles(home, anchor).anchors().listed_domain(grant.domain)
    if grant.domain == anchor.domain or listed is not None:
        signer = anchor if listed is None else listed.anchor
        Verifier(signer.public_key, signer.domain, (), 0, _not_asked).open(token, now)
    check_time(grant, now)
    if grant.holder != home.identity(now).thumbprint:
        raise GrantNotHeld(
            f"grant {grant.short_id} is bound to another key than that of {home.name}",
            f"the domain {grant.domain} gave it to {shown(grant.subject)}: install it there",
        )
    return grant


def _not_asked(entry: bytes, now: int) -> None:
    """Revocation is looked up by who knows a list."""
