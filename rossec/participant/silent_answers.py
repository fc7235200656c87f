"""What a client library does not tell its program, so that somebody else has to say it. Pure.

rospy and roscpp drop the answer to `setParam`, and a graph of which a node may see nothing looks
like a graph in which there is nothing.
"""

from collections.abc import Sequence
from typing import Final

from ca.errors import NameRefused
from ca.names import check_name
from rossec.participant.caller_names import RELATIVE_NAME
from rossec.ros.names import canonical

UNHEARD: Final = frozenset({"setParam", "deleteParam"})
"""Calls to the master whose refusal does not reach the program."""
GRAPH: Final = frozenset({"getSystemState", "getTopicTypes", "getPublishedTopics"})
"""Calls that are answered with what the caller may see."""


def unheard_refusal(method: str, params: Sequence[object], answer: object) -> str | None:
    """Why a call was refused of which the program does not hear it; None: it is none of these.

    What rossec itself refuses has a reason of its own in its status, and is not meant here.
    """
    match answer:
        case [code, str(status), *_] if code != 1 and method in UNHEARD:
            return _of_name(params[RELATIVE_NAME[method] :][:1]) or status
        case _:
            return None


def _of_name(named: Sequence[object]) -> str:
    """What is wrong with the name in a call, and what would not be; empty: nothing."""
    for name in named:
        try:
            check_name(canonical(str(name)))
        except NameRefused as error:
            return f"{error} ({error.hint})"
    return ""


def shows_nothing(method: str, answer: object) -> bool:
    """Whether a node asked for the graph and was shown nothing of it."""
    match answer:
        case [1, _, list(found)] if method in GRAPH:
            return not any(found)
        case _:
            return False


def nothing_shown(node: str) -> str:
    """What is said then."""
    return f"nothing that {node} may see; all of it needs: rossec grant sign {node} --graph"
