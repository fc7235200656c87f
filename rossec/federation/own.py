"""What following needs of the master it runs in."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from ca.certificates import Identity
from rossec.federation.chains import Chains
from rossec.master.server.effects import Effects, MasterState
from rossec.master.state.sites import Site
from rossec.net.aio import SecureContext


@dataclass(frozen=True)
class OwnMaster:
    """The master that follows.

    Args:
        state: what it knows.
        effects: delivers events.
        context: its own identity, to dial with; its `verify` is that of `chains`.
        chains: the certificates by which peers were verified.
        mirror: takes over the parameters of a site; raises ImportRefused.
        drop_mirror: forgets those of the site with this label.
        grants: reads the grants in its home, which another master wants to see.
    """

    state: MasterState
    effects: Effects
    context: SecureContext[Identity]
    mirror: Callable[[Site, dict[str, object]], None]
    drop_mirror: Callable[[str], None]
    chains: Chains = field(default_factory=Chains)
    grants: Callable[[], Sequence[bytes]] = tuple

    @property
    def name(self) -> str:
        """Its certified name, the `caller_id` of every call."""
        return self.state.name
