"""The routers as a relay uses them: links to mailboxes, and mailboxes that are read. A shell."""

from collections.abc import Awaitable, Callable
from typing import Final

from ca.certificates import Identity
from rossec.net.aio import SecureContext, SecureStream
from rossec.overlay.endpoint import LinkListener, dial_link
from rossec.overlay.routers import Routers
from rossec.overlay.zenoh_carrier import Carrier


class RouterNetwork:
    """A carrier and the identity whose links it carries."""

    def __init__(
        self, carrier: Carrier, routers: Routers, context: SecureContext[Identity]
    ) -> None:
        self.seat: Final = routers.seat
        self._carrier = carrier
        self._context = context

    @property
    def router(self) -> str:
        """The router in use; empty: none, one is looked for."""
        return self._carrier.router

    async def dial(self, mailbox: str) -> SecureStream[Identity]:
        """A link to whoever reads this mailbox.

        Raises:
            RossecError, TimeoutError: nobody answers, or the handshake fails.
        """
        return await dial_link(self._carrier, mailbox, self.seat, self._context)

    def listen(
        self,
        mailbox: str,
        serve: Callable[[SecureStream[Identity]], Awaitable[None]],
        label: str,
    ) -> LinkListener[Identity]:
        """Call `serve` with each authenticated link that arrives in this mailbox.

        Unfinished handshakes are limited for each `label`, that of the peer it was told to.

        Raises:
            OverlayUnavailable: the session with the routers is closed.
        """
        return LinkListener(
            self._carrier, mailbox, self._context, serve, address=f"a link from {label}"
        )
