"""The process that holds the key, while it runs: socket, time and audit put together. A shell."""

import asyncio
import logging
from collections.abc import Callable
from typing import Final

from ca.authority import Authority
from ca.encoding import Value
from ca.errors import HintedError
from ca.keys.signer import Signer
from rossec import clock
from rossec.authority.home import AuthorityHome, fingerprint
from rossec.authority.keyservice import messages, recognize
from rossec.authority.keyservice.caller import Caller
from rossec.authority.keyservice.held_key import HeldKey
from rossec.authority.keyservice.messages import SOCKET, Request
from rossec.authority.keyservice.operations import KeyOperations
from rossec.authority.keyservice.server import KeyServer
from rossec.errors import KeyServiceRefused
from rossec.net.host.peeruid import UnixPeer
from rossec.operation.audit import AuditFile
from rossec.operation.audit_log import AUDIT

TICK: Final = 1.0  # seconds between two looks at the clock
_log = logging.getLogger("rossec.authority.service")


def operations_of(
    home: AuthorityHome, audit: Callable[[str], None], join_port: Callable[[], int] = int
) -> KeyOperations:
    """The operations on the key of the authority in `home`, which is locked.

    `join_port`: where nodes join now; 0: nowhere.
    """
    anchor, own = home.anchor(), home.intermediate()
    subject = anchor.subject if own is None else anchor.read_intermediate(own).subject
    about: dict[int | str, Value] = {
        "domain": anchor.domain,
        "fingerprint": fingerprint(anchor),
        "started": clock.now(),
    }

    def load(secret: str) -> Signer:
        """The key, if it belongs to the certificate."""
        return Authority(home.load_key(secret), anchor.certificate, own).signer

    authority = recognize.Authority(subject, anchor.domain)
    describe = lambda: {**about, "join_port": join_port()}  # noqa: E731 - one expression
    return KeyOperations(HeldKey(load), authority, audit, describe)


def audit_to(file: AuditFile) -> Callable[[str], None]:
    """Writes lines to the audit, and raises `KeyServiceRefused` where one is not written."""
    audit = logging.getLogger(AUDIT)

    def write(text: str) -> None:
        audit.info("%s", text)
        if file.is_failing:
            raise KeyServiceRefused(
                "the audit cannot be written, so nothing is signed", "make room on the disk"
            )

    return write


class KeyServiceProcess:
    """Answers commands at the socket, and drops the key when its time is over.

    Args:
        home: of the authority.
        operations: of its key.
        admit: raises `PeerUserRefused` for a process that may not ask.
        phone_code: makes a code for the console, for a caller; audited.
    """

    def __init__(
        self,
        home: AuthorityHome,
        operations: KeyOperations,
        admit: Callable[[UnixPeer], None],
        phone_code: Callable[[Caller], str] | None = None,
    ) -> None:
        self.operations = operations
        self._phone_code = phone_code
        self._server = KeyServer(home.path / SOCKET, self._carry_out, admit)

    async def start(self) -> None:
        """Listen; raises as `KeyServer.start`."""
        await self._server.start()

    async def close(self) -> None:
        """Stop listening, and drop the key."""
        await self._server.close()
        self.operations.held.lock()

    async def watch_time(self) -> None:
        """Drop the key when its time is over, until this is cancelled.

        The loop's clock stops while the machine sleeps: so the other one is read every second.
        """
        while True:
            try:
                self.operations.lock_if_over()
            except HintedError as error:  # the key is dropped, only the line is missing
                _log.error("%s", error)
            await asyncio.sleep(TICK)

    async def _carry_out(self, request: Request, caller: Caller) -> Value:
        if request.operation == messages.PHONE_CODE:
            if self._phone_code is None:
                raise KeyServiceRefused("this service has no console", "restart: rossec ca serve")
            return self._phone_code(caller)
        if request.operation == messages.UNLOCK:
            return await asyncio.to_thread(self.operations.carry_out, request, caller)
        return self.operations.carry_out(request, caller)
