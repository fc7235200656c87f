"""What the client library of every ROS program asks for by itself, whatever the program is for.

rospy and roscpp publish their log, offer two services to change its levels, follow `/clock` where
time is simulated, and read the settings below. A program works without them; `basics` of a policy
(`grants.policy.basics`) gives them. Names of the node's own are written after `{node}/`.
Sources: rospy `client.py`, `impl/{simtime,statistics,tcpros_base,rosout}.py`; roscpp
`init.cpp`, `rosout_appender.cpp`, `statistics.cpp`, `topic_manager.cpp`.
"""

import re
from collections.abc import Mapping
from typing import Final

from ca.names import covers
from grants.model import Right

OWN: Final = "{node}/"
TRANSFORMS: Final = ("/tf", "/tf_static")
BASICS: Final[Mapping[Right, tuple[str, ...]]] = {
    Right.PUBLISH: ("/rosout",),
    Right.PROVIDE: (f"{OWN}get_loggers", f"{OWN}set_logger_level"),
    Right.SUBSCRIBE: ("/clock",),
    Right.PARAM_GET: (
        "/use_sim_time", "/tcp_keepalive", "/rosout_disable_topics_generation",
        "/enable_statistics",
        "/statistics_window_min_elements", "/statistics_window_max_elements",
        "/statistics_window_min_size", "/statistics_window_max_size",
    ),
}  # fmt: skip

# rospy ends the name of an anonymous node with its start in ms, roscpp in ns.
_TIMED: Final = re.compile(r"(?:_[A-Za-z0-9]+)*_[0-9]{9,}", re.ASCII)
_RUN: Final = re.compile(r"(?:_[0-9]+)*_[0-9]{9,}(?=/|$)", re.ASCII)


def own_form(node: str, name: str, *, wildcard: bool = False) -> str:
    """`name`, written with `{node}/` where it lies below the node's own name.

    `wildcard`: `node` is certified with a tail, and has the names of all its anonymous nodes.
    """
    parts = name.split("/")
    depth = node.count("/") + 1
    asker = "/".join(parts[:depth])
    if len(parts) > depth and (covers(node, asker, wildcard=wildcard) or is_timed(node, asker)):
        return OWN + "/".join(parts[depth:])
    return name


def is_timed(node: str, name: str) -> bool:
    """Whether `name` is that of one run of an anonymous node of `node`: it will not come again."""
    return name.startswith(node) and _TIMED.fullmatch(name, len(node)) is not None


def lasting_name(name: str) -> str:
    """The name of an anonymous node without the numbers of one run; any other as it is."""
    return _RUN.sub("", name)


def is_basic(right: Right, own: str) -> bool:
    """Whether a client library asks for `right` on `own`, in the form of `own_form`, by itself."""
    return own in BASICS.get(right, ())


def is_dispensable(right: Right, own: str) -> bool:
    """Whether it is such a right, and a program works without it: without `/clock` time stands."""
    return right is not Right.SUBSCRIBE and is_basic(right, own)
