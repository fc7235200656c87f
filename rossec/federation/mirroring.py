"""Parameters of another master, read where a site names patterns of them. A shell.

They are read every few seconds on the connection that is followed: so no address of this master is
needed there, and it is not registered there as a subscriber. What is read is a copy: it is set at
its origin only. The other master decides by grants what may be read (`param-get`).
"""

import time
from typing import Any, Final

from ca.patterns import covers
from grants.model import Right
from rossec.errors import AnswerMalformed, AnswerRefused
from rossec.federation.own import OwnMaster
from rossec.federation.settings import SiteSettings
from rossec.net.rpc.client import RpcClient

EVERY: Final = 5.0  # seconds between two readings
MAX_NAMES: Final = 4096  # of one site
_AT_ONCE: Final = 128


class Mirroring:
    """Reads the parameters that `settings` names.

    Attributes:
        mirrored: how many parameters there are.
    """

    def __init__(self, own: OwnMaster, settings: SiteSettings) -> None:
        self._own = own
        self._settings = settings
        self._read_at = -EVERY
        self._names_held: list[str] = []
        self.mirrored = 0

    async def keep(self, client: RpcClient) -> None:
        """Read again, if it is time.

        Raises:
            RossecError: no answer, a malformed one, or more than can be mirrored.
        """
        if not self._settings.parameters or time.monotonic() - self._read_at < EVERY:
            return
        self._read_at = time.monotonic()
        names = await self._names(client)
        tree: dict[str, Any] = {}
        self.mirrored = 0
        for begin in range(0, len(names), _AT_ONCE):
            for name, value in await self._values(client, names[begin : begin + _AT_ONCE]):
                _put(tree, name, value)
                self.mirrored += 1
        if not all(map(self._is_taken, names)):  # there is another list meanwhile: read again
            self._read_at = -EVERY
            return
        self._own.mirror(self._settings.site, tree)
        self._names_held = names

    def judge(self) -> None:
        """There is another list of domains: forget what is not taken from that domain any more."""
        if any(not self._is_taken(name) for name in self._names_held):
            self.drop()

    def drop(self) -> None:
        """Forget what was mirrored."""
        self.mirrored, self._read_at, self._names_held = 0, -EVERY, []
        self._own.drop_mirror(self._settings.label)

    async def _names(self, client: RpcClient) -> list[str]:
        found = await client.ask("getParamNames", self._own.name)
        if not isinstance(found, list):
            raise AnswerMalformed("a master's answer without names of parameters")
        names = [each for each in found if isinstance(each, str) and self._is_wanted(each)]
        if len(names) > MAX_NAMES:
            raise AnswerRefused(
                f"{self._settings.label} has {len(names)} parameters of these patterns, not"
                f" {MAX_NAMES} at most", "mirror fewer: `rossec federation param`"
            )  # fmt: skip
        return sorted(names)

    def _is_wanted(self, name: str) -> bool:
        wanted = any(covers(pattern, name) for pattern in self._settings.parameters)
        return wanted and self._is_taken(name)

    def _is_taken(self, name: str) -> bool:
        """Whether the list of domains lets this parameter of a foreign domain in."""
        label = self._settings.domain
        taken = self._own.state.trust.domains.imported(label) if label else None
        return taken is None or taken.covers(Right.PARAM_GET, name)

    async def _values(self, client: RpcClient, names: list[str]) -> list[tuple[str, Any]]:
        """The values of those that are still set, and may be read."""
        calls = [{"methodName": "getParam", "params": [self._own.name, name]} for name in names]
        answers = await client.call("system.multicall", calls)
        if not isinstance(answers, list) or len(answers) != len(names):
            raise AnswerMalformed("a master's answer without values of parameters")
        found: list[tuple[str, Any]] = []
        for name, answer in zip(names, answers, strict=True):
            match answer:
                case [[1, str(), value]]:
                    found.append((name, value))
                case _:
                    pass  # it was unset meanwhile, or may not be read
        return found


def _put(tree: dict[str, Any], name: str, value: object) -> None:
    *path, last = name.strip("/").split("/")
    for each in path:
        inner = tree.setdefault(each, {})
        if not isinstance(inner, dict):
            raise AnswerMalformed("a parameter below a value")
        tree = inner
    tree[last] = value
