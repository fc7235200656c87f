"""Enrollment of a node that waits: its port, the person who confirms, the authority that connects, the code
in a picture.

Callers are unauthenticated: a limited number at a time, each with a deadline; a message that is refused ends
its connection, and is reported to the person in one line. `rossec node confirm` reaches the waiting `rossec
node enroll` by a socket in the node's directory. The authority connects twice, as a person decides between
the request and the offer.
"""

import asyncio
import json
import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, Final, Self, TypeAlias

from ca import errors
from ca.enrollment.messages import Abort, Delivery, Reason, read, write
from ca.enrollment.sides import AuthorityEnrollment, AuthorityState, NodeEnrollment, NodeState, Pending
from rossec.enrollment import sessions
from rossec.enrollment.scanner import CLOSER, MAX_FILE, SECONDS
from rossec.enrollment.sessions import SessionServer, wait_closed
from rossec.errors import ConfigurationError, NotDelivered, PeerUnreachable
from rossec.host import addresses, local_sockets
from rossec.net.limits import HalfOpenLimits
from rossec.peer_limits import printable

PATIENCE: Final = 10.0  # seconds without a message from a caller
RETRY_DELAY: Final = 0.5
SCANNER: Final = (sys.executable, "-I", "-m", "rossec.enrollment.scanner")
_AUTHORITY_PATIENCE: Final = 10.0  # seconds to connect, and for the request
_TRIES: Final = 5
_NAME: Final = "enrolling.sock"
_LIMIT: Final = 4096
_PATIENCE: Final = 30.0
_CAPS: Final = HalfOpenLimits(per_address=4, total=16)
_REASONS: Final[dict[type[errors.EnrollmentRefused], Reason]] = {
    errors.ConflictingOffer: Reason.CONFLICT,
    errors.EnrollmentOver: Reason.OVER,
    errors.EnrollmentExpired: Reason.OVER,
}

Answer: TypeAlias = dict[str, str]


class WaitingNode(SessionServer):
    """A node that waits for its enrollment; `on_refusal` gets a line for each caller that is refused."""

    def __init__(
        self,
        core: NodeEnrollment,
        clock: Callable[[], int],
        on_refusal: Callable[[str], None],
        patience: float = PATIENCE,
    ) -> None:
        self.core = core
        self._clock = clock
        self._on_refusal = on_refusal
        self._patience = patience
        super().__init__(self._run, _CAPS)
        self._waiting: set[asyncio.StreamWriter] = set()
        self._changed = asyncio.Event()

    async def until(self, *states: NodeState, every: Callable[[int], None]) -> None:
        """Wait for one of `states`; `every` is called each second with the seconds left."""
        while self.core.state not in states:
            if self.core.end_reason is not None:
                raise self.core.end_reason
            every(self.core.expires - self._clock())
            with suppress(TimeoutError):
                async with asyncio.timeout(1):
                    await self._changed.wait()
            self._changed.clear()
            self.core.tick(self._clock())

    def confirm(self, digits: str, activate: Callable[[Pending], None]) -> None:
        """A person confirmed: `activate` writes the identity, then the authority is notified."""
        try:
            pending = self.core.confirm(digits, self._clock())
            activate(pending)
        except BaseException as error:
            # Confirmed and not on the disk: the node has no identity, and must not say that it is enrolled.
            if self.core.state is NodeState.CONFIRMED:
                self.core.stop(errors.EnrollmentOver(f"the identity could not be written: {error}"))
            self._state_changed()
            raise
        self._send_all(self.core.activated())
        self._changed.set()

    def stop(self, why: errors.EnrollmentRefused) -> None:
        self.core.stop(why)
        self._state_changed()

    async def close(self) -> None:
        """Stop listening; callers that wait for the result get it."""
        self.stop_listening()
        leaving = [*self._waiting]
        for writer in leaving:
            writer.close()
        for writer in leaving:
            await wait_closed(writer)
        await super().close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def _run(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, address: str) -> None:
        try:
            while True:
                waits = writer in self._waiting  # for the result
                patience = max(1, self.core.expires - self._clock() + 1) if waits else self._patience
                async with asyncio.timeout(patience):
                    data = await sessions.receive(reader)
                self._answer(writer, data)
                async with asyncio.timeout(self._patience):  # a caller that does not read is not written to
                    await writer.drain()
        except errors.EnrollmentRefused as error:
            self._on_refusal(printable(f"{address}: {error}"))
            sessions.send(writer, _abort(error))
        except TimeoutError:
            writer.transport.abort()  # close() would wait for a caller that does not read
        except (OSError, EOFError):
            pass  # the caller may connect again
        finally:
            self._waiting.discard(writer)
            writer.close()

    def _answer(self, writer: asyncio.StreamWriter, data: bytes) -> None:
        before = self.core.state
        try:
            answers = self.core.receive(data, self._clock())
        finally:
            if self.core.state is not before:
                self._state_changed()
        for answer in answers:
            sessions.send(writer, answer)
        if not isinstance(read(answers[0]), Delivery):
            self._waiting.add(writer)

    def _state_changed(self) -> None:
        self._changed.set()
        if self.core.state is NodeState.OVER and self.core.end_reason is not None:
            self._send_all([_abort(self.core.end_reason)])

    def _send_all(self, messages: list[bytes]) -> None:
        for writer in self._waiting:
            for message in messages:
                sessions.send(writer, message)


def _abort(error: errors.EnrollmentRefused) -> bytes:
    return write(Abort(_REASONS.get(type(error), Reason.REFUSED)))


async def serve(directory: Path, answer: Callable[[Answer], Answer]) -> asyncio.Server:
    async def call(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            # The same user, or root. The digits are not secret, but confirming them activates a trust anchor:
            # so this never goes over the network.
            if local_sockets.unix_peer(writer.get_extra_info("socket")).user in {0, os.getuid()}:
                async with asyncio.timeout(_PATIENCE):
                    request = json.loads(await reader.readline())
                if not isinstance(request, dict):
                    raise ValueError("not a request")
                try:
                    found = answer(request)
                except errors.HintedError as error:
                    found = {"error": str(error), "hint": error.hint}
                writer.write(json.dumps(found).encode() + b"\n")
        except (OSError, ValueError, TimeoutError):
            pass  # a malformed request gets no answer
        finally:
            writer.close()

    other = _connect(directory)
    if other is not None:
        other.close()
        raise ConfigurationError(
            "an enrollment of this node is waiting already", "finish or stop that one first"
        )
    with _socket_path(directory) as path:
        return await asyncio.start_unix_server(call, path, limit=_LIMIT)


def remove(directory: Path) -> None:
    (directory / _NAME).unlink(missing_ok=True)


def ask(directory: Path, request: Answer) -> Answer:
    sock = _connect(directory)
    if sock is None:
        raise ConfigurationError("no enrollment of this node is waiting", "first: rossec node enroll NAME")
    line = b""
    sock.settimeout(_PATIENCE)
    with sock, suppress(OSError), sock.makefile("rb") as stream:
        sock.sendall(json.dumps(request).encode() + b"\n")
        line = stream.readline(_LIMIT)
    if not line:
        raise ConfigurationError("the waiting enrollment has just ended", "see its last message")
    answer: Answer = json.loads(line)
    if "error" in answer:
        raise ConfigurationError(answer["error"], answer.get("hint", ""))
    return answer


def _connect(directory: Path) -> socket.socket | None:
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        with _socket_path(directory) as path:
            sock.connect(path)
    except (FileNotFoundError, ConnectionRefusedError):
        sock.close()
        return None
    return sock


@contextmanager
def _socket_path(directory: Path) -> Iterator[str]:
    # Through /proc: the path of a Unix socket has at most 107 octets, a directory's may have more.
    descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield f"/proc/self/fd/{descriptor}/{_NAME}"
    finally:
        os.close(descriptor)


async def fetch(core: AuthorityEnrollment, host: str, port: int, clock: Callable[[], int]) -> None:
    """Fetch the request of the node at `host` into `core`, or raise `PeerUnreachable`."""
    try:
        async with (
            sessions.connected(host, port, _AUTHORITY_PATIENCE) as (reader, writer),
            asyncio.timeout(_AUTHORITY_PATIENCE),
        ):
            sessions.send(writer, core.fetch())
            core.receive(await sessions.receive(reader), clock())
    except (OSError, EOFError, TimeoutError) as error:
        raise PeerUnreachable(
            f"no node waits to be enrolled at {addresses.join(host, port)}",
            "is `rossec node enroll` still running there, and on the same network?",
        ) from error


async def deliver(
    core: AuthorityEnrollment,
    offer: bytes,
    host: str,
    port: int,
    clock: Callable[[], int],
    show: Callable[[str], None],
) -> None:
    """Deliver `offer`, `show` the digits, and return when the node reports that it is enrolled."""
    failures, state = 0, core.state
    while failures < _TRIES:
        try:
            async with sessions.connected(host, port, _AUTHORITY_PATIENCE) as (reader, writer):
                # Exactly the same offer each time: another one would be a second party to the node.
                sessions.send(writer, offer)
                shown = core.digits
                while core.state is not AuthorityState.ENROLLED:
                    async with asyncio.timeout(max(1, core.deadline - clock() + 1)):
                        data = await sessions.receive(reader)
                    core.receive(data, clock())
                    if core.digits != shown:
                        shown = core.digits
                        show(shown)
                return
        except (OSError, EOFError, TimeoutError, errors.EnrollmentMessageRefused):
            core.tick(clock())
            # What got on counts anew: a person may take minutes while the line breaks now and then.
            failures, state = (failures + 1 if core.state is state else 0), core.state
            await asyncio.sleep(RETRY_DELAY)
    raise NotDelivered(
        "the node closed the connection before it reported that it is enrolled",
        f"check there: rossec node show {core.request.name}",
    )


# A picture (a photograph, a screenshot, a frame of a camera) is decoded in a process of its own, with a time
# limit; no answer, or anything but a few texts, means that there is no code.


def code_in_file(path: Path, stdin: BinaryIO) -> str:
    """The one code in a picture (`-`: in `stdin`), or `ConfigurationError`."""
    if str(path) == "-":
        return code_in(stdin.read(MAX_FILE + 1))
    with path.open("rb") as file:
        return code_in(file.read(MAX_FILE + 1))


def code_in(data: bytes) -> str:
    if len(data) > MAX_FILE:
        raise ConfigurationError(f"the picture has more than {MAX_FILE} bytes", CLOSER)
    try:
        done = subprocess.run(  # noqa: S603 - our own program, by its full path
            SCANNER, input=data, capture_output=True, timeout=3 * SECONDS, check=True
        )
        answer = json.loads(done.stdout)
    except (subprocess.SubprocessError, ValueError) as error:
        raise ConfigurationError("reading the picture took too long, or failed", CLOSER) from error
    if "error" in answer:
        raise ConfigurationError(answer["error"], answer["hint"])
    match [str(text) for text in answer["texts"]]:
        case [text]:
            return text
        case []:
            raise ConfigurationError("there is no rossec code in the picture", CLOSER)
        case found:
            raise ConfigurationError(f"there are {len(found)} codes in the picture", "show one of them alone")
