"""A call that the authority has somebody make at the master: what is needed for it, and no more."""

from typing import NamedTuple

from rossec.home import NodeHome


class MasterCall(NamedTuple):
    """A signed statement for the master, or a query: called as `node`, the authority's own.

    `what` names it in errors, `hint` says how to deliver it later, `note` is to be shown if set.
    `within`: seconds until it fails; None: the usual deadlines. `waits`: the master answers when
    there is something new, so that a slow answer is no sign of one that is out of reach.
    """

    node: NodeHome
    method: str
    statement: tuple[object, ...]
    what: str
    hint: str
    note: str = ""
    within: float | None = None
    waits: bool = False
