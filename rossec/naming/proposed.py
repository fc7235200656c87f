"""The names that rules give, checked: absolute ROS names, and none that others trust. Pure.

What lies below these names is not for rules: identities that nodes trust (`/master`, `/ca`,
`/relay`), those of the own services, names of other domains (`/remote`), and topics that every
node may use without a grant.
"""

from typing import Final

from ca.errors import NameRefused
from ca.names import check_name
from rossec.errors import ProposedNameRefused

RESERVED: Final = frozenset({
    "remote", "master", "ca", "relay", "gateway", "router", "console", "border", "namespace",
    "sidecar", "rossec", "rosout", "rosout_agg", "clock",
})  # fmt: skip
THESIS_DEFAULTS: Final = ("unknown-group", "unknown-node", "unknown-location")


def check_proposed(text: str, *, thesis_defaults: bool = False) -> str:
    """Return `text` if rules may give it as a name.

    Args:
        text: what the rules gave.
        thesis_defaults: allow the thesis's defaults as segments, though ROS has no `-` in names.

    Raises:
        ProposedNameRefused: not an absolute ROS name, or a reserved one.
    """
    try:
        check_name(_legal(text) if thesis_defaults else text)
    except NameRefused as error:
        raise ProposedNameRefused(f"the rules do not give a name: {error}", error.hint) from None
    first = text.split("/")[1]
    if first in RESERVED:
        raise ProposedNameRefused(
            f"the rules gave {text}, which is reserved", f"no rule may put anything below /{first}"
        )
    return text


def _legal(text: str) -> str:
    """`text` with the thesis's defaults, where they are whole segments, as they are in ROS."""
    return "/".join(
        segment.replace("-", "_") if segment in THESIS_DEFAULTS else segment
        for segment in text.split("/")
    )
