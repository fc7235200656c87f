"""The terminal of `rossec node enroll`: its code, its messages, and the confirmation."""

import asyncio
import os
import re
import signal
import sys
import termios
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from ca.certificates import to_pem
from ca.enrollment import qr
from ca.enrollment.node import NodeEnrollment, NodeState, Pending
from ca.enrollment.transcript import group_digits
from ca.errors import EnrollmentOver, HintedError
from rossec import files
from rossec.authority.home import fingerprint
from rossec.cli.shared.context import now
from rossec.enrollment import address, control
from rossec.enrollment.node import WaitingNode
from rossec.home import NodeHome
from rossec.ros.settings import is_loopback
from rossec.terminal import note, printable, say, say_picture

SAME_DIGITS: Final = "does the authority show the same digits?"
_CLEAR: Final = "\r\x1b[K"
_MAX_LINE: Final = 256
_MAX_REFUSALS: Final = 10  # any peer that reaches the port could fill the screen


class EnrollmentScreen:
    """One run of `rossec node enroll`: the waiting node, its screen and its operator."""

    def __init__(
        self,
        home: NodeHome,
        core: NodeEnrollment,
        *,
        label: bool,
        png: Path | None,
        svg: Path | None,
    ) -> None:
        self._home = home
        self._core = core
        self._label = label
        self._png, self._svg = png, svg
        self._refusals = 0
        self._node = WaitingNode(core, now, self._show_refusal)

    async def run(self, host: str, port: int) -> None:
        """Show the code, and return when the node is enrolled.

        Raises:
            EnrollmentRefused: it is not; the reason.
        """
        stopped = EnrollmentOver("the enrollment was stopped")
        asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, self._node.stop, stopped)
        listener = await control.serve(self._home.path, self._handle_control)
        try:
            async with self._node:
                await self._node.listen(host if is_loopback(host) else None, port)
                self._show(host)
                await self._wait()
        finally:
            listener.close()
            control.remove(self._home.path)

    async def _wait(self) -> None:
        try:
            await self._node.until(NodeState.PENDING, NodeState.ENROLLED, every=self._countdown)
            self._clear_line()
            with self._confirmation():
                await self._node.until(NodeState.ENROLLED, every=lambda _: None)
        finally:
            self._node.stop(EnrollmentOver("the node has stopped waiting"))
            self._clear_line()
        say(f"{self._home.name} is enrolled in {self._core.request.domain}")

    def _show(self, host: str) -> None:
        where = address.join(host, self._node.port)
        text = self._core.code(where)
        for path, picture in ((self._png, qr.png), (self._svg, qr.svg)):
            if path is not None:
                files.replace(path, picture(text), 0o644 if self._label else 0o600)
        if not self._label:
            say_picture(qr.terminal(text))
        say(text)
        # Without the code: an argument is seen by every user of that host.
        command = "rossec ca enroll" + f" --address {where}" * self._label
        say(f"{self._home.name} waits at {where}; at the authority, which asks for it: {command}")

    def _countdown(self, left: int) -> None:
        if is_live():
            minutes, seconds = divmod(max(0, left), 60)
            sys.stderr.write(f"{_CLEAR}{minutes}:{seconds:02} left ")
            sys.stderr.flush()

    def _clear_line(self) -> None:
        if is_live():
            sys.stderr.write(_CLEAR)

    def _show_refusal(self, what: str) -> None:
        self._refusals += 1
        if self._refusals <= _MAX_REFUSALS:
            self._clear_line()
            note(f"refused {what}")
        if self._refusals == _MAX_REFUSALS:
            note("further refusals are not shown")

    @contextmanager
    def _confirmation(self) -> Iterator[None]:
        """An offer is pending: show it, and read the answer if stdin is a terminal."""
        for line in authority_lines(self._pending()):
            say(line)
        if not sys.stdin.isatty():
            say(f"the same at the authority? then: rossec node confirm {self._home.name} DIGITS")
            yield
            return
        # Input typed before the digits were shown is not an answer.
        termios.tcflush(sys.stdin, termios.TCIFLUSH)
        sys.stderr.write(f"{SAME_DIGITS} [y/N]: ")
        sys.stderr.flush()
        loop, stdin = asyncio.get_running_loop(), sys.stdin.fileno()
        loop.add_reader(stdin, self._read_answer, stdin)
        try:
            yield
        finally:
            loop.remove_reader(stdin)

    def _read_answer(self, stdin: int) -> None:
        answer = os.read(stdin, _MAX_LINE).decode(errors="replace").strip().lower()
        if not confirms(answer, self._core.pending.digits):
            self._node.stop(EnrollmentOver("the digits were not confirmed", "nothing was accepted"))
            return
        with suppress(HintedError):  # the session gets the error from the node
            self._node.confirm(self._core.pending.digits, self._activate)

    def _pending(self) -> control.Answer:
        pending = self._core.pending
        anchor = pending.anchor
        return {
            "digits": pending.digits,
            "domain": anchor.domain,
            "authority": fingerprint(anchor),
        }

    def _handle_control(self, request: control.Answer) -> control.Answer:
        """To `rossec node confirm`."""
        if request.get("do") == "confirm":
            self._node.confirm(str(request.get("digits")), self._activate)
            return {}
        return self._pending()

    def _activate(self, pending: Pending) -> None:
        """From here on the node trusts the authority."""
        self._home.install(to_pem(*pending.chain, pending.root), now())


def confirms(answer: str, digits: str) -> bool:
    """Whether `answer` to "the same digits?" is yes; who types the right ones has compared them."""
    return answer in {"y", "yes"} or re.sub("[ -]", "", answer) == digits


def is_live() -> bool:
    """Whether stderr is a terminal, which can show a countdown."""
    return sys.stderr.isatty()


def authority_lines(pending: control.Answer) -> list[str]:
    """The authority of the offer, and the digits to compare."""
    return [
        f"authority of {printable(pending['domain'])}, fingerprint {pending['authority']}",
        f"digits {group_digits(pending['digits'])}",
    ]
