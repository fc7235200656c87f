"""A router as a process: Zenoh does the routing, this begins, watches and ends it. A shell.

Zenoh's own log is never begun: at its finer levels it would name inboxes.
"""

import asyncio
import logging
import threading
from typing import Any, Final

from rossec.errors import ConfigurationError, OverlayUnavailable, RossecError
from rossec.overlay.homes import RouterHome
from rossec.overlay.router_settings import Accounts, RouterSettings, zenoh_settings
from rossec.overlay.zenoh_carrier import open_session

_log = logging.getLogger("rossec.overlay.router")
_PERIOD: Final = 0.5  # seconds between two looks
_CERTIFICATE_PERIOD: Final = 24 * 3600.0  # seconds
CLOSING: Final = 5.0  # seconds


class Router:
    """One router, of the directory `home`; used on one loop. `is_open`: whoever reaches it may use it."""

    def __init__(self, home: RouterHome, settings: RouterSettings, *, is_open: bool) -> None:
        self._home, self._settings, self._is_open = home, settings, is_open
        self._accounts_version: tuple[int, ...] = ()
        self._certificate_due = 0.0
        self._session: Any = None
        self._joined = 0

    async def start(self) -> None:
        self._accounts_version = self._home.accounts_version()
        await self._begin(accounts_of(self._home, is_open=self._is_open))

    async def _begin(self, accounts: Accounts | None) -> None:
        self._certificate_due = asyncio.get_running_loop().time() + _CERTIFICATE_PERIOD
        self._home.write_for_zenoh(self._settings, accounts)
        found = zenoh_settings(self._settings, accounts, self._home.files)
        try:
            self._session = await asyncio.to_thread(open_session, found)
        except OverlayUnavailable as error:
            if error.hint:  # the library is not there
                raise
            where = ", ".join(self._settings.listen)
            raise OverlayUnavailable(
                f"the router cannot listen at {where}: {error}",
                "does something else listen there? --listen tls/[::]:PORT",
            ) from error

    async def run(self) -> None:
        """Watch what it was started with, and take over what changes, until cancelled."""
        while True:
            await asyncio.sleep(_PERIOD)
            if self._session is not None and self.joined != self._joined:
                self._joined = self.joined
                _log.info("sessions with other routers: %d", self._joined)
            try:
                await self._take_over()
            except (RossecError, OSError) as error:
                _log.error("what changed is not taken over: %s", error)

    async def close(self) -> None:
        """End it. A session that does not end in time ends with the process."""
        session, self._session = self._session, None
        if session is not None:
            closing = threading.Thread(target=session.close, daemon=True)  # no exit waits for it
            closing.start()
            await asyncio.to_thread(closing.join, CLOSING)

    @property
    def joined(self) -> int:
        return 0 if self._session is None else len(self._session.info.routers_zid())

    async def _take_over(self) -> None:
        # Begin anew if accounts changed, if the certificate may be old, or if it is not listening: Zenoh
        # reads its users, rules and certificate once. It takes less than a second, which links of relays
        # survive.
        due = asyncio.get_running_loop().time() >= self._certificate_due
        if self._session is not None and not due:
            version = self._home.accounts_version()
            changed, self._accounts_version = version != self._accounts_version, version
            if not changed:
                return
        accounts: Accounts | None = self._home.accounts()  # if they are damaged, the old ones stay in force
        if self._is_open:
            accounts = accounts_of(self._home, is_open=True)
        await self.close()
        await self._begin(accounts)
        _log.info("the router began anew, with the accounts and the certificate of now")


def accounts_of(home: RouterHome, *, is_open: bool) -> Accounts | None:
    """The accounts of a router that begins; None: it is open to all."""
    accounts = home.accounts()
    if is_open and accounts.names:
        raise ConfigurationError(
            f"the router has accounts ({', '.join(accounts.names)}), so it is not open",
            "leave out --open, or remove them: rossec router accounts remove NAME",
        )
    if not is_open and not accounts.names:
        raise ConfigurationError(
            "nobody has an account at this router",
            "give accounts: rossec router accounts add NAME > NAME.account; or let in everybody: --open",
        )
    return None if is_open else accounts
