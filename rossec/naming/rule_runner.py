"""Names asked for of rules: `async with RuleRunner(rules) as runner: await runner.name(...)`.

Rules and documents go to a confined process, which forks for each request: what one caller sent can change no
answer to another. Requests beyond the number of processes wait.
"""

import asyncio
import importlib.util
import subprocess
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from importlib.resources import files
from types import TracebackType
from typing import Final, Self

from rossec.errors import ProposedNameRefused, RossecError, RulesExceeded, RulesNotConfined
from rossec.host.workers import AskedWorker, worker_command
from rossec.naming import requests
from rossec.naming.requests import NameKind, NameRequest, Result, check_proposed, check_query

RULES: Final = "names.xsl"
LIBRARY: Final = "lxml"
CHILD: Final = worker_command("rossec.naming.child")
START: Final = 20.0  # seconds until it is confined
SECONDS: Final = 5.0  # wall clock for a request


def shipped_rules(name: str = RULES) -> bytes:
    return files("rossec.naming").joinpath("rules", name).read_bytes()


def shipped_example(name: str) -> bytes:
    return files("rossec.naming").joinpath("examples", name).read_bytes()


def require_extra(library: str = LIBRARY) -> None:
    """Refuse names by rules where the extra `names` is not installed."""
    if importlib.util.find_spec(library) is None:
        raise RossecError(
            f"names by rules need {library}, which is not installed",
            "install the extra: pip install 'rossec[names]'",
        )


class RuleProcess:
    """One process that applies rules. After any exception of `ask` it must be closed."""

    def __init__(self, command: Sequence[str] = CHILD) -> None:
        try:
            self.worker = AskedWorker(command, stderr=subprocess.DEVNULL, cwd="/")
        except OSError as error:
            raise RulesNotConfined(f"the process for rules does not start: {error}") from error
        self._is_ready = False
        self.close = self.worker.close

    async def ask(self, body: bytes, seconds: float) -> bytes:
        if not self._is_ready:
            try:
                async with asyncio.timeout(START):
                    first = await self.worker.receive(requests.answer_size)
            except (OSError, EOFError, RulesExceeded) as error:  # TimeoutError is an OSError
                hint = "run python -m rossec.naming.child to see why"
                raise RulesNotConfined("the process for rules does not start", hint) from error
            if first != requests.READY:
                requests.read_names(first, 0)  # which raises why, if it says so
                raise RulesNotConfined("the process for rules says nothing of being confined")
            self._is_ready = True
        try:
            async with asyncio.timeout(seconds):
                return await self.worker.ask(requests.frame(body), requests.answer_size)
        except TimeoutError:
            raise RulesExceeded(f"the rules took longer than {seconds:g} s") from None
        except (OSError, EOFError) as error:
            raise RulesExceeded("the process for rules ended") from error


class RuleRunner:
    """One set of rules (XSLT 1.0, with the short form `<parameter>`), applied to what callers send.

    `thesis_defaults`: give `unknown-group` and others as the thesis has them; ROS has no such names, so they
    are for comparisons only. `seconds` are wall clock; the process itself limits its processor time.
    """

    def __init__(
        self,
        rules: bytes,
        *,
        thesis_defaults: bool = False,
        children: int = 1,
        seconds: float = SECONDS,
        start: Callable[[], RuleProcess] = RuleProcess,
    ) -> None:
        self._rules, self._thesis_defaults = rules, thesis_defaults
        self._seconds, self._start = seconds, start
        self._free = asyncio.Semaphore(children)
        self._idle: list[RuleProcess] = []
        self._is_closed = False

    async def __aenter__(self) -> Self:
        require_extra()
        requests.check_rules(self._rules)
        try:
            requests.read_names(await self._ask(b"", ()), 0)
        except BaseException:
            self.close()
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    async def name(self, metadata: bytes, kind: NameKind = NameKind.NODE, which: str = "") -> str:
        (result,) = await self.names(metadata, [(kind, which)])
        if isinstance(result, RossecError):
            raise result
        return result

    async def names(self, metadata: bytes, queries: Sequence[tuple[NameKind, str]]) -> list[Result]:
        """The names for all `queries`, in their order; each a name, or the error instead."""
        requests.check_document(metadata)
        asked = tuple(check_query(*query) for query in queries)
        if not asked:
            return []
        results = requests.read_names(await self._ask(metadata, asked), len(asked))
        for number, result in enumerate(results):
            if isinstance(result, str):
                # A process that was taken over may have written it: no name leaves that is none, or reserved.
                try:
                    check_proposed(result, thesis_defaults=self._thesis_defaults)
                except ProposedNameRefused as error:
                    results[number] = error
        return results

    def close(self) -> None:
        """End all processes; one that answers a request ends after it, and no other starts."""
        self._is_closed = True
        while self._idle:
            self._idle.pop().close()

    async def _ask(self, document: bytes, queries: tuple[tuple[NameKind, str], ...]) -> bytes:
        request = NameRequest(self._rules, document, queries, self._thesis_defaults)
        async with self._process() as process:
            return await process.ask(requests.write_request(request), self._seconds)

    @asynccontextmanager
    async def _process(self) -> AsyncIterator[RuleProcess]:
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

    def _take(self) -> RuleProcess:
        if self._is_closed:
            raise RulesExceeded("the processes for rules have ended")
        while self._idle:
            process = self._idle.pop()
            if not process.worker.has_ended:
                return process
            process.close()
        return self._start()
