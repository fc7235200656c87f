"""How many requests for identities those who may only look have put into the record.

Preparing an enrollment records its request, which then waits for a day. The record has room for
256, and one who only looks could fill it with codes of their own; so a few of them are all there
are at a time, and the rest stays free for phones, commands and nodes that join.
"""

from contextlib import closing
from hashlib import sha256
from typing import Final

from ca.encoding import Value
from rossec.authority.console import owners
from rossec.authority.home import AuthorityHome
from rossec.errors import KeyServiceRefused

MAX_REQUESTS: Final = 32


class LookersRequests:
    """The requests that were prepared by those who may only look, by the digest of the CSR."""

    def __init__(self) -> None:
        self._prepared: dict[bytes, None] = {}

    def check(
        self, home: AuthorityHome, arguments: tuple[Value, ...], owner: str, now: int
    ) -> None:
        """Return if `owner` may have a request recorded, of which `arguments` begin with the CSR.

        Raises:
            KeyServiceRefused: so many of them wait already.
        """
        if owners.rank(owner) or not arguments or not isinstance(arguments[0], bytes):
            return
        with closing(home.store()) as store:
            waiting = {row.digest for row in store.requests.open(now)}
        digest = sha256(arguments[0]).digest()
        self._prepared = {each: None for each in self._prepared if each in waiting}
        if digest in waiting:
            return
        if len(self._prepared) >= MAX_REQUESTS:
            raise KeyServiceRefused(
                f"{MAX_REQUESTS} nodes wait that were added without a phone",
                "approve or deny them, or log in with the phone",
            )
        self._prepared[digest] = None
