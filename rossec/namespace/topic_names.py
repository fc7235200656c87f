"""The service `/get_topic_name`: answers with names, and applies none of them.

Metadata are claims of the caller, and a name is worth nothing without a grant. What a caller sends
is bounded in size before it is read, in time by the rules' process, and in number by its turns:
others get their answers meanwhile.
"""

from collections.abc import Awaitable, Callable
from typing import Any, Final

from ca.certificates import Identity
from ca.errors import HintedError
from rossec.errors import NameUndefined, RossecError, ServiceFailed
from rossec.namespace.turns import CallerTurns
from rossec.naming.frames import Result
from rossec.naming.metadata import Kind
from rossec.naming.runner import RuleRunner
from rossec.ros.text import printable

SERVICE: Final = "/get_topic_name"
CHILDREN: Final = 4
SECONDS: Final = 1.0  # for an answer of the rules
DEADLINE: Final = 10.0  # seconds for a call, its turn included
WAITING: Final = 8  # requests of one caller
CALLS: Final = 64  # at a time, of all callers
PARAMETER: Final = "metadata"
_TEXT: Final = 300
_NOTHING: Final = "there are no metadata: send them, or set the parameter ~metadata"


class TopicNames:
    """Names for what callers publish, subscribe and serve.

    Args:
        runner: of the rules, with `CHILDREN` processes and `SECONDS` for each answer.
        parameter: reads a parameter; it raises `HintedError` if it cannot.
    """

    def __init__(self, runner: RuleRunner, parameter: Callable[[str], Awaitable[object]]) -> None:
        self._runner = runner
        self._parameter = parameter
        self._turns = CallerTurns(CHILDREN, WAITING)

    async def answer(self, request: Any, caller: Identity) -> dict[str, object]:
        """The response to one request of `caller`.

        Raises:
            ServiceFailed: there is no name; the caller is told why.
        """
        async with self._turns.turn(caller.thumbprint):
            metadata = request.metadata if request.metadata.strip() else await self._own(caller)
            try:
                return {"topicname": await self._name(metadata.encode(), request.name)}
            except RossecError as error:
                raise ServiceFailed(printable(str(error), _TEXT)) from error

    async def _own(self, caller: Identity) -> str:
        """The metadata in the caller's parameter, where the thesis has them."""
        try:
            found = await self._parameter(f"{caller.name}/{PARAMETER}")
        except HintedError as error:
            raise ServiceFailed(_NOTHING) from error
        if not isinstance(found, str) or not found.strip():
            raise ServiceFailed(_NOTHING)
        return found

    async def _name(self, metadata: bytes, which: str) -> str:
        """The name of a topic, or else of a service: the request does not say which it is."""
        kinds = (Kind.TOPIC, Kind.SERVICE)
        found = await self._runner.names(metadata, [(kind, which) for kind in kinds])
        return _first(found)


def _first(results: list[Result]) -> str:
    """The first name; where there is none, the error that says most.

    Raises:
        RossecError: no name.
    """
    for result in results:
        if isinstance(result, str):
            return result
    errors = [result for result in results if isinstance(result, RossecError)]
    raise next((error for error in errors if not isinstance(error, NameUndefined)), errors[0])
