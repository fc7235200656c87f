import os
import re
import signal
import socket
from collections.abc import Iterator

import pytest

from rossec.cli.node.enroll import confirms
from rossec.host import addresses
from tests.rossec.cli.node.operators import Operator, after, typist
from tests.support.commands import Shell, refused


@pytest.fixture
def keyboard(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A terminal is standard input; what is written to the descriptor was typed."""
    written, screen = os.openpty()
    with os.fdopen(screen) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        monkeypatch.setattr("rossec.cli.node.enroll.is_live", lambda: True)
        yield written
    os.close(written)


@pytest.mark.parametrize(("answer", "code"), [("y\n", 0), ("n\n", 1), ("\n", 1)])
def test_the_answer_at_the_terminal_decides(empty: Shell, keyboard: int, answer: str, code: int) -> None:
    with typist(keyboard, answer) as begins:
        operator = Operator(empty, begins)
        operator.start()
        said = empty(*operator.words)
        operator.join()
    assert said.code == code, said.err
    assert "does the authority show the same digits? [y/N]: " in said.err
    assert re.search(r"[45]:[0-9]{2} left ", said.err)
    assert (operator.node / "node.pem").exists() == (code == 0)
    assert (operator.node / "ca.pem").exists() == (code == 0)
    if code == 1:
        assert "rossec: error: the digits were not confirmed" in said.err
        assert "the node has ended the enrollment" in str(operator.error)


def test_refused_connections_are_reported_up_to_a_limit(empty: Shell) -> None:
    def knock(operator: Operator, digits: str) -> None:
        assert operator.core is not None
        for _ in range(12):
            with socket.create_connection(addresses.split(operator.core._code.address)) as stranger:
                stranger.sendall(b"GET / HTTP/1.1\r\n\r\n")
                while stranger.recv(100):
                    pass
        operator.confirm(digits)

    operator = Operator(empty, knock)
    operator.start()
    said = empty(*operator.words)
    operator.join()
    assert said.code == 0
    assert said.err.count("rossec: refused 127.0.0.1: a message of 1195725856 octets") == 10
    assert said.err.count("further refusals are not shown") == 1


def test_a_signal_stops_the_enrollment(empty: Shell) -> None:
    png = empty.root / "code.png"
    stopper = after(lambda: os.kill(os.getpid(), 15), png.exists)
    said = empty("node", "enroll", "/robot", "--address", "127.0.0.1", "--png", str(png))
    stopper.join()
    refused(said, "the enrollment was stopped")
    assert not (empty.node("/robot") / "enrolling.sock").exists()


def test_input_before_the_digits_is_ignored(empty: Shell, keyboard: int) -> None:
    os.write(keyboard, b"y\n")
    with typist(keyboard, "n\n") as begins:
        operator = Operator(empty, begins)
        operator.start()
        said = empty(*operator.words)
        operator.join()
    assert "rossec: error: the digits were not confirmed" in said.err
    assert not (operator.node / "ca.pem").exists()


@pytest.mark.parametrize("label", [False, True])
def test_a_picture_with_a_secret_is_readable_by_the_owner_only(empty: Shell, label: bool) -> None:
    picture = empty.root / "code.png"
    words = ("node", "enroll", "/robot", "--address", "127.0.0.1", "--png", str(picture))
    stopper = after(lambda: os.kill(os.getpid(), signal.SIGTERM), picture.exists)
    refused(empty(*words, *["--label", "--port", "0"] * label), "the enrollment was stopped")
    stopper.join()
    assert picture.stat().st_mode & 0o777 == (0o644 if label else 0o600)


@pytest.mark.parametrize(
    ("answer", "yes"),
    [
        ("y", True),
        ("yes", True),
        ("123456", True),
        ("123 456", True),
        ("123-456", True),
        ("", False),
        ("123457", False),
        ("12345", False),
        ("yep", False),
    ],
)
def test_the_digits_themselves_are_a_yes(answer: str, yes: bool) -> None:
    assert confirms(answer, "123456") is yes
