"""The service `/get_topic_name`: answers with names, and applies none of them; its package for catkin.

Metadata are claims of the caller, and a name is worth nothing without a grant.
"""

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from importlib.resources import files as resources
from pathlib import Path
from typing import Any, Final

from ca.certificates import Identity
from ca.errors import HintedError
from rossec import files
from rossec.errors import ConfigurationError, NameUndefined, RossecError, ServiceFailed
from rossec.naming import NameKind, RuleRunner
from rossec.participant.service_types import ServiceType, register_service_type
from rossec.peer_limits import printable

# The fields of the type are the thesis's (appendix A): programs that were written for its `GetTopicName`
# call this service, since ROS compares md5sums.
PACKAGE: Final = "rossec_namespace"
TYPE: Final = f"{PACKAGE}/GetTopicName"
_SRV: Final = "srv/GetTopicName.srv"
_FILES: Final = ("package.xml", "CMakeLists.txt", _SRV)
_MODE: Final = 0o644
SERVICE: Final = "/get_topic_name"
CHILDREN: Final = 4
SECONDS: Final = 1.0  # for an answer of the rules
DEADLINE: Final = 10.0  # seconds for a call, its turn included
WAITING: Final = 8  # requests of one caller
CALLS: Final = 64  # at a time, of all callers
PARAMETER: Final = "metadata"
_TEXT: Final = 300
_NOTHING: Final = "there are no metadata: send them, or set the parameter ~metadata"


def service_type() -> ServiceType:
    return register_service_type(TYPE, _text(_SRV))


def _text(name: str) -> str:
    return resources("rossec.namespace").joinpath(PACKAGE, *name.split("/")).read_text()


def write(directory: Path) -> Path:
    package = directory / PACKAGE
    if package.exists():
        raise ConfigurationError(f"{package} exists and is not overwritten", "remove it first")
    (package / "srv").mkdir(parents=True)
    for name in _FILES:
        files.create(package / name, _text(name).encode(), _MODE)
    return package


class TopicNames:
    """Names for what callers publish, subscribe and serve.

    `runner` has `CHILDREN` processes and `SECONDS` for each answer; `parameter` raises `HintedError`.
    """

    def __init__(self, runner: RuleRunner, parameter: Callable[[str], Awaitable[object]]) -> None:
        self._runner, self._parameter = runner, parameter
        self._turns = CallerTurns(CHILDREN, WAITING)

    async def answer(self, request: Any, caller: Identity) -> dict[str, object]:
        # What a caller sends is bounded in size before it is read, in time by the rules' process, and in
        # number by its turns: others get their answers meanwhile.
        async with self._turns.turn(caller.thumbprint):
            metadata = request.metadata if request.metadata.strip() else await self._own(caller)
            try:
                return {"topicname": await self._name(metadata.encode(), request.name)}
            except RossecError as error:
                raise ServiceFailed(printable(str(error), _TEXT)) from error

    async def _own(self, caller: Identity) -> str:
        try:
            found = await self._parameter(f"{caller.name}/{PARAMETER}")
        except HintedError as error:
            raise ServiceFailed(_NOTHING) from error
        if not isinstance(found, str) or not found.strip():
            raise ServiceFailed(_NOTHING)
        return found

    async def _name(self, metadata: bytes, which: str) -> str:
        # The name of a topic, or else of a service: the request does not say which it is.
        kinds = (NameKind.TOPIC, NameKind.SERVICE)
        results = await self._runner.names(metadata, [(kind, which) for kind in kinds])
        errors = [result for result in results if isinstance(result, RossecError)]
        for result in results:
            if isinstance(result, str):
                return result
        raise next((error for error in errors if not isinstance(error, NameUndefined)), errors[0])


class CallerTurns:
    """Places that callers take in turns: what one asks for delays no other by more than its turn."""

    # A caller has one turn at a time, and `waiting` requests that wait for it; more are refused. Free places
    # go to one caller after the other, however many requests each of them has.

    def __init__(self, places: int, waiting: int) -> None:
        self._free, self._waiting = places, waiting
        self._having: set[bytes] = set()
        self._queues: dict[bytes, deque[asyncio.Future[None]]] = {}  # in the order of their turns

    @asynccontextmanager
    async def turn(self, caller: bytes) -> AsyncIterator[None]:
        queue = self._queues.setdefault(caller, deque())
        if len(queue) >= self._waiting:
            raise ServiceFailed(f"{self._waiting} requests of yours wait already")
        mine = asyncio.get_running_loop().create_future()
        queue.append(mine)
        self._give()
        try:
            await mine
            yield
        finally:
            self._end(caller, mine)

    def _end(self, caller: bytes, mine: "asyncio.Future[None]") -> None:
        if mine.done() and not mine.cancelled():
            self._free += 1
            self._having.discard(caller)
            if caller in self._queues:
                self._queues[caller] = self._queues.pop(caller)  # behind all others
        else:
            queue = self._queues.get(caller, deque())
            if mine in queue:
                queue.remove(mine)
            if not queue:
                self._queues.pop(caller, None)
        self._give()

    def _give(self) -> None:
        for caller in list(self._queues):
            if not self._free:
                return
            if caller in self._having:
                continue
            queue = self._queues.pop(caller)
            while queue and queue[0].cancelled():
                queue.popleft()
            if queue:
                queue.popleft().set_result(None)
                self._free -= 1
                self._having.add(caller)
            if queue:
                self._queues[caller] = queue  # behind all others
