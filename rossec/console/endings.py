"""Whether what was ended has ended: nobody may still see it. Pure.

A revocation is over when every node with a session has its list, which the master says: the third
tick of its page. Until then somebody may still see, so no page says *ended*. That is remembered,
since a master that does not answer now told it before. A node without a session takes no messages
for long: its view of the list is stale within two minutes and it cuts what does not outlive that
(`on_stale: keep`, grant.md section 4). That helps only where the master has the list: one that has
not goes on confirming the old one.
"""

from typing import Final, NamedTuple

from rossec.authority.console.views import ListStanding

STALE: Final = 300  # seconds after which no node without a session goes on, with some to spare


class Heard(NamedTuple):
    """Every node has what was ended before these times.

    `cut`: no connection that ends with a stale list is left of what was ended before this one.
    """

    all: int = 0
    cut: int = 0

    def has(self, ended_at: int, *, keeps: bool) -> bool:
        """Whether what was ended then is over; `keeps`: it outlives a stale list."""
        return ended_at < (self.all if keeps else max(self.all, self.cut))


class Endings:
    """What this console was told of it."""

    def __init__(self) -> None:
        self._heard = Heard()

    @property
    def heard(self) -> Heard:
        """As far as it is known."""
        return self._heard

    def note(self, standing: ListStanding, asked_at: int) -> None:
        """Take note of how far the list of all that was ended before `asked_at` has come."""
        if not (standing.is_signed and standing.is_at_master):
            return
        every, cut = self._heard
        if 0 < standing.nodes == standing.nodes_with_list:
            every = max(every, asked_at)
        elif not standing.nodes:
            cut = max(cut, asked_at - STALE)
        self._heard = Heard(every, cut)
