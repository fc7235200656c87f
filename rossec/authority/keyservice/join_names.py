"""Names by rules for nodes that join. A shell around `rossec.naming`.

The service holds the authority's key, so it reads no metadata: they go, as they came, to the
process for rules, and only when the secret of an invitation was proved. What comes back is a name
that was checked; here it is compared with the invitation. The rules decide twice: for the claim,
and for the request that follows it, since what is between may lie.
"""

import logging
from types import TracebackType
from typing import Final, Self

from ca.enrollment.join_messages import NameAnswer, Named, Refused, RefuseReason
from ca.names import is_reserved
from ca.patterns import covers
from rossec.errors import RossecError
from rossec.naming.runner import RuleRunner
from rossec.ros.text import printable

CHILDREN: Final = 2
SECONDS: Final = 1.0  # for one answer of the rules
_log = logging.getLogger("rossec.authority.service")


class JoinNames:
    """The rules of one authority; without rules no node is named.

    Args:
        rules: a stylesheet, or None.
    """

    def __init__(self, rules: bytes | None) -> None:
        self._runner: RuleRunner | None = None
        if rules is not None:
            self._runner = RuleRunner(rules, children=CHILDREN, seconds=SECONDS)

    async def __aenter__(self) -> Self:
        """Try the rules.

        Raises:
            RossecError: they are refused, or cannot be applied here; as `RuleRunner`.
        """
        if self._runner is not None:
            await self._runner.__aenter__()
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._runner is not None:
            self._runner.close()

    async def answer(self, metadata: bytes, pattern: str) -> NameAnswer:
        """The name for `metadata`, if an invitation for `pattern` allows it."""
        if self._runner is None:
            return Refused(RefuseReason.UNNAMED)
        try:
            name = await self._runner.name(metadata)
        except RossecError as error:
            _log.warning("a node that joins has no name: %s", printable(error))
            return Refused(RefuseReason.METADATA)
        if is_reserved(name) or not covers(pattern, name):
            return Refused(RefuseReason.NAME)
        return Named(name)
