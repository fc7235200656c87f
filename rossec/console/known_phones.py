"""Whether the phone that began a session still counts: it may be removed at the terminal.

A session outlives what began it by at most `KEPT`. A phone that is registered again under the name
of one that was removed does not bring its sessions back. Where the service does not answer nobody
is let in.
"""

from collections.abc import Awaitable, Callable
from typing import Final

from rossec import clock
from rossec.authority.console.views import PhoneView
from rossec.console.sessions import Session

KEPT: Final = 2.0  # seconds for which an answer is taken

Phones = Callable[[], Awaitable[tuple[PhoneView, ...]]]


class KnownPhones:
    """The phones of the record, as they were asked for last.

    Args:
        phones: asks the service.
        elapsed: seconds of a clock that cannot be set.
    """

    def __init__(self, phones: Phones, elapsed: clock.Seconds | None = None) -> None:
        self._phones = phones
        self._elapsed = clock.counter() if elapsed is None else elapsed
        self._asked = float("-inf")
        self._known: tuple[PhoneView, ...] = ()

    async def counts(self, session: Session) -> bool:
        """Whether the phone of a session is still registered; a session by a code has none.

        Raises:
            HintedError: the service does not answer.
        """
        is_fresh = self._elapsed() - self._asked < KEPT
        if not session.phone or (is_fresh and self._is_known(session)):
            return True
        asked = self._elapsed()
        self._known = await self._phones()  # also for a phone that was set up just now
        self._asked = asked
        return self._is_known(session)

    def _is_known(self, session: Session) -> bool:
        for each in self._known:
            if each.name == session.phone and not each.ended:  # one at most
                session.passkey = session.passkey or each.id
                return session.passkey == each.id
        return False
