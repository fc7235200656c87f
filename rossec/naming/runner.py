"""Names asked for of rules: `async with RuleRunner(rules) as runner: await runner.name(...)`.

Rules and documents go to a confined process, which forks for each request: what one caller sent
can change no answer to another. Requests beyond the number of processes wait. Whatever comes back
is checked here again: no name leaves that is not one, or that is reserved.
"""

import asyncio
import importlib.util
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from types import TracebackType
from typing import Final, Self

from rossec.errors import NamesExtraMissing, ProposedNameRefused, RossecError, RulesExceeded
from rossec.naming import documents, frames
from rossec.naming.child_process import RuleProcess
from rossec.naming.frames import NameRequest, Result
from rossec.naming.metadata import Kind, check_query
from rossec.naming.proposed import check_proposed

SECONDS: Final = 5.0  # wall clock for a request
LIBRARY: Final = "lxml"


def require_extra(library: str = LIBRARY) -> None:
    """Return if rules can be applied here.

    Raises:
        NamesExtraMissing: the library for it is not installed.
    """
    if importlib.util.find_spec(library) is None:
        raise NamesExtraMissing(
            f"names by rules need {library}, which is not installed",
            "install the extra: pip install 'rossec[names]'",
        )


class RuleRunner:
    """One set of rules, applied to what callers send.

    Args:
        rules: a stylesheet of XSLT 1.0, with the short form `<parameter>`; at most 256 KiB.
        thesis_defaults: give `unknown-group` and others as the thesis has them; ROS has no such
            names, so they are for comparisons only.
        children: how many processes answer at the same time; each is started when it is needed.
        seconds: for a request, wall clock; 2 s of processor time are the process's own limit.
        start: starts a process.
    """

    def __init__(
        self,
        rules: bytes,
        *,
        thesis_defaults: bool = False,
        children: int = 1,
        seconds: float = SECONDS,
        start: Callable[[], RuleProcess] = RuleProcess.start,
    ) -> None:
        self._rules = rules
        self._thesis_defaults = thesis_defaults
        self._seconds = seconds
        self._start = start
        self._free = asyncio.Semaphore(children)
        self._idle: list[RuleProcess] = []
        self._is_closed = False

    async def __aenter__(self) -> Self:
        """Start the first process and compile the rules once.

        Raises:
            NamesExtraMissing: lxml is not installed.
            RulesRefused: the rules are malformed or use what they may not; the line is named.
            RulesExceeded: to compile them took too much.
            RulesNotConfined: the process cannot be started or confined.
        """
        require_extra()
        documents.check_rules(self._rules)
        try:
            frames.read_names(await self._ask(b"", ()), 0)
        except BaseException:
            self.close()
            raise
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    async def name(self, metadata: bytes, kind: Kind = Kind.NODE, which: str = "") -> str:
        """The name of the node, or of its topic or service `which`.

        Raises:
            MetadataRefused: malformed or too long.
            NameUndefined: the rules give none, or several.
            ProposedNameRefused: what they give is no ROS name, or a reserved one.
            RulesRefused, RulesExceeded, RulesNotConfined: the rules fail, or take too much.
        """
        (result,) = await self.names(metadata, [(kind, which)])
        if isinstance(result, RossecError):
            raise result
        return result

    async def names(self, metadata: bytes, queries: Sequence[tuple[Kind, str]]) -> list[Result]:
        """The names for all `queries`, in their order; each a name, or the error instead.

        Raises:
            MetadataRefused, RulesRefused, RulesExceeded, RulesNotConfined: for all of them.
        """
        documents.check_document(metadata)
        asked = tuple(check_query(*query) for query in queries)
        if not asked:
            return []
        results = frames.read_names(await self._ask(metadata, asked), len(asked))
        return [self._checked(result) for result in results]

    def close(self) -> None:
        """End all processes; one that answers a request ends after it, and no other starts."""
        self._is_closed = True
        while self._idle:
            self._idle.pop().close()

    def _checked(self, result: Result) -> Result:
        if isinstance(result, RossecError):
            return result
        try:
            return check_proposed(result, thesis_defaults=self._thesis_defaults)
        except ProposedNameRefused as error:
            return error

    async def _ask(self, document: bytes, queries: tuple[tuple[Kind, str], ...]) -> bytes:
        request = NameRequest(self._rules, document, queries, self._thesis_defaults)
        body = frames.write_request(request)
        async with self._process() as process:
            return await process.ask(body, self._seconds)

    def _take(self) -> RuleProcess:
        if self._is_closed:
            raise RulesExceeded("the processes for rules have ended")
        while self._idle:
            process = self._idle.pop()
            if not process.has_ended:
                return process
            process.close()
        return self._start()

    @asynccontextmanager
    async def _process(self) -> AsyncIterator[RuleProcess]:
        """A process for one request; it is kept for the next if the request was answered."""
        async with self._free:
            process = self._take()
            try:
                yield process
            except BaseException:
                process.close()
                raise
            if self._is_closed:
                process.close()
            else:
                self._idle.append(process)
