import asyncio
import os
import re
import secrets
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from ca.certificates import from_pem
from ca.enrollment import qr
from ca.enrollment.authority import AuthorityEnrollment, AuthorityState
from ca.errors import HintedError
from rossec.cli.main import run
from rossec.enrollment import address, authority, control
from rossec.enrollment.scan import code_in
from rossec.home import NodeHome
from tests.support.commands import Shell, refused
from tests.support.enrolling import clock, fresh
from tests.support.pki import Site

SITE = Site.create(now=clock())


class Operator(threading.Thread):
    """Somebody at the authority, who sees the node's code and calls it; `then` gets the digits."""

    def __init__(
        self, shell: Shell, then: Callable[["Operator", str], object], *, site: Site = SITE
    ) -> None:
        super().__init__()
        self.png = shell.root / "code.png"
        self.node = shell.node("/robot")
        self.port = 0
        self.site = site
        self.core: AuthorityEnrollment | None = None
        self.error: Exception | None = None
        self._then = then

    @property
    def words(self) -> tuple[str, ...]:
        return ("node", "enroll", "/robot", "--address", "127.0.0.1", "--png", str(self.png))

    def show(self, digits: str) -> None:
        self._then(self, digits)

    def confirm(self, digits: str) -> None:
        control.ask(self.node, {"do": "confirm", "digits": digits})

    def run(self) -> None:
        until = time.monotonic() + 30
        while not self.png.exists():
            assert time.monotonic() < until
            time.sleep(0.01)
        code = qr.parse(code_in(self.png.read_bytes()))
        host, port = address.split(code.address) if code.address else ("127.0.0.1", self.port)
        self.core = AuthorityEnrollment(code, "home")
        try:
            asyncio.run(self.enroll(self.core, host, port))
        except (HintedError, OSError) as error:
            self.error = error

    async def enroll(self, core: AuthorityEnrollment, host: str, port: int) -> None:
        await authority.fetch(core, host, port, clock)
        core.approve(clock())
        leaf = self.site.authority.issue(
            core.csr, now=clock(), serial=secrets.randbits(120), wildcard=core.request.wildcard
        )
        offer = core.offer([leaf], self.site.root, fresh(), clock())
        await authority.deliver(core, offer, host, port, clock, self.show)


def after(action: Callable[[], object], until: Callable[[], bool]) -> threading.Thread:
    """Do something as soon as something else has happened."""

    def work() -> None:
        limit = time.monotonic() + 30
        while not until():
            assert time.monotonic() < limit
            time.sleep(0.01)
        action()

    thread = threading.Thread(target=work)
    thread.start()
    return thread


def test_a_node_is_enrolled(empty: Shell) -> None:
    operator = Operator(empty, Operator.confirm)
    operator.start()
    svg = empty.root / "code.svg"
    said = empty(*operator.words, "--svg", str(svg))
    operator.join()
    assert said.code == 0, said.err
    assert operator.core is not None
    assert operator.core.state is AuthorityState.ENROLLED
    digits = operator.core.digits
    lines = said.out.splitlines()
    assert lines[-1] == "/robot is enrolled in home"
    assert f"digits {digits[:3]} {digits[3:]}" in lines
    assert any(
        re.fullmatch(r"authority of home, fingerprint [0-9a-f ]{39}", line) for line in lines
    )
    assert any(line.startswith("/robot waits at 127.0.0.1:") for line in lines)
    assert b"<svg" in svg.read_bytes()
    home = NodeHome.of(empty.root, "/robot")
    assert home.identity(clock()).name == "/robot"
    assert home.anchor().certificate == SITE.root
    assert from_pem((home.path / "ca.pem").read_bytes()) == (SITE.root,)


def test_the_command_that_confirms(empty: Shell) -> None:
    """In another shell; here from the thread of the operator, who walks to the robot."""
    codes: list[int] = []

    def walk(_: Operator, digits: str) -> None:
        typed = (
            ("12345",),
            (str((int(digits) + 1) % 10**6).zfill(6),),
            (digits[:3], f"-{digits[3:]}"),
        )
        codes.extend(
            run(("node", "confirm", "/robot", "--", *words), empty.environ) for words in typed
        )

    operator = Operator(empty, walk)
    operator.start()
    said = empty(*operator.words)
    operator.join()
    assert codes == [1, 1, 0]
    assert said.code == 0
    assert "rossec: error: the authority shows six digits\n" in said.err
    assert "rossec: error: these are not the digits of the offer" in said.err


def test_confirming_what_is_shown(empty: Shell) -> None:
    def press(*_: object) -> None:
        assert run(("node", "confirm", "/robot", "--yes"), empty.environ) == 0

    operator = Operator(empty, press)
    operator.start()
    said = empty(*operator.words)
    operator.join()
    assert said.code == 0
    assert said.out.count("digits ") == 2


def test_nothing_waits_to_be_confirmed(shell: Shell) -> None:
    for words in (("123", "456"), ()):
        said = shell("node", "confirm", "/robot", *words)
        refused(said, "no enrollment of this node is waiting", "rossec node enroll")


@pytest.fixture
def keyboard(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A terminal is standard input; what is written to the descriptor was typed."""
    written, screen = os.openpty()
    with os.fdopen(screen) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        monkeypatch.setattr("rossec.cli.node.enroll_screen.is_live", lambda: True)
        yield written
    os.close(written)


@contextmanager
def typist(keyboard: int, answer: str) -> Iterator[Callable[..., None]]:
    """Gives what makes a person answer, again and again: what comes before a question is lost."""
    asked, ended = threading.Event(), threading.Event()

    def types() -> None:
        asked.wait()
        while not ended.wait(0.05):
            os.write(keyboard, answer.encode())

    person = threading.Thread(target=types)
    person.start()
    try:
        yield lambda *_: asked.set()
    finally:
        ended.set()
        asked.set()
        person.join()


@pytest.mark.parametrize(("answer", "code"), [("y\n", 0), ("n\n", 1), ("\n", 1)])
def test_the_person_at_the_terminal(empty: Shell, keyboard: int, answer: str, code: int) -> None:
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


def test_another_authority_is_not_trusted_as_well(empty: Shell) -> None:
    operator = Operator(empty, Operator.confirm)
    operator.start()
    assert empty(*operator.words).code == 0
    operator.join()
    before = (operator.node / "ca.pem").read_bytes()
    operator.png.unlink()
    other = Operator(empty, Operator.confirm, site=Site.create(now=clock()))
    other.start()
    said = empty(*other.words)
    other.join()
    refused(said, "could not be written: /robot trusts another authority already")
    assert isinstance(other.error, HintedError)
    assert (operator.node / "ca.pem").read_bytes() == before


def test_enrolling_again(empty: Shell) -> None:
    """The same key, a new request: an identity is renewed by hand."""
    for _ in range(2):
        operator = Operator(empty, Operator.confirm)
        operator.start()
        assert empty(*operator.words).code == 0
        operator.join()
        operator.png.unlink()


def test_a_label(empty: Shell) -> None:
    assert empty("node", "labels", "/robot", "--out", str(empty.root / "sheet.html")).code == 0
    operator = Operator(empty, Operator.confirm)
    operator.port = free_port()
    label = qr.label_code((empty.node("/robot") / "node.csr").read_bytes())
    operator.start()
    said = empty(*operator.words, "--label", "--port", str(operator.port), "--for", "10m")
    operator.join()
    assert said.code == 0, said.err
    assert said.out.startswith(f"{label}\n/robot waits at 127.0.0.1:{operator.port}; ")
    assert f"rossec ca enroll --address 127.0.0.1:{operator.port}\n" in said.out


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port: int = server.getsockname()[1]
        return port


def test_anonymous_nodes(empty: Shell) -> None:
    operator = Operator(empty, Operator.confirm)
    operator.start()

    class Either(AuthorityEnrollment):
        def __init__(self, code: qr.Code, domain: str) -> None:
            super().__init__(code, domain, wildcard=True)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tests.rossec.cli.node.test_enroll.AuthorityEnrollment", Either)
        assert empty(*operator.words, "--anonymous").code == 0
        operator.join()
    assert NodeHome.of(empty.root, "/robot").identity(clock()).covers("/robot_1_2")


def test_strangers_are_reported(empty: Shell) -> None:
    def knock(operator: Operator, digits: str) -> None:
        assert operator.core is not None
        for _ in range(12):
            with socket.create_connection(address.split(operator.core._code.address)) as stranger:
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
    assert said.err.count("further callers are refused without a word") == 1


def test_stopping(empty: Shell) -> None:
    png = empty.root / "code.png"
    stopper = after(lambda: os.kill(os.getpid(), 15), png.exists)
    said = empty("node", "enroll", "/robot", "--address", "127.0.0.1", "--png", str(png))
    stopper.join()
    refused(said, "the enrollment was stopped")
    assert not (empty.node("/robot") / "enrolling.sock").exists()


def test_a_second_enrollment_of_one_node(empty: Shell) -> None:
    png = empty.root / "code.png"
    codes: list[int] = []

    def second() -> None:
        try:
            asyncio.run(control.serve(empty.node("/robot"), lambda _: {}))
        except HintedError:
            codes.append(1)
        os.kill(os.getpid(), 15)

    other = after(second, png.exists)
    empty("node", "enroll", "/robot", "--address", "127.0.0.1", "--png", str(png))
    other.join()
    assert codes == [1]


def test_a_window_is_for_labels(empty: Shell) -> None:
    refused(empty("node", "enroll", "/robot", "--for", "1h"), "--for needs --label", code=2)
    assert not empty.node("/robot").exists()


def test_the_address_in_the_code(empty: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    def shown(**environ: str) -> tuple[str, str]:
        png = empty.root / "code.png"
        png.unlink(missing_ok=True)
        empty.environ.pop("ROS_IP", None)
        empty.environ.update(environ)
        stopper = after(lambda: os.kill(os.getpid(), 15), png.exists)
        said = empty("node", "enroll", "/robot", "--png", str(png))
        stopper.join()
        return qr.parse(code_in(png.read_bytes())).address, said.err

    where, _ = shown(ROS_IP="192.168.7.7")
    assert where.startswith("192.168.7.7:")
    monkeypatch.setattr(address, "own_addresses", lambda: ["10.0.0.7", "fd00::7"])
    where, err = shown()
    assert where.startswith("10.0.0.7:")
    assert "other addresses of this host, for --address: fd00::7" in err
    monkeypatch.setattr(address, "own_addresses", lambda: ["10.0.0.7"])
    _, err = shown()
    assert "other addresses" not in err


def test_labels(empty: Shell) -> None:
    sheet = empty.root / "sheet.html"
    said = empty("node", "labels", "/robot", "/door", "--out", str(sheet))
    assert said.out == f"2 labels in {sheet}: print it without scaling\n"
    html = sheet.read_text()
    assert ">/robot</text>" in html
    assert ">/door</text>" in html
    said = empty("node", "labels", "/robot", "--out", str(sheet))
    assert said.out.startswith("1 label in ")
    refused(empty("node", "labels", "robot", "--out", str(sheet)), "not an absolute ROS name")


def test_a_request_of_another_key(empty: Shell) -> None:
    for name in ("/robot", "/door"):
        empty("node", "request", name)
    request = (empty.node("/door") / "node.csr").read_bytes()
    (empty.node("/robot") / "node.csr").write_bytes(request)
    refused(empty("node", "labels", "/robot", "--out", str(empty.root / "x")), "for another key")


def test_what_was_typed_before_the_digits_confirms_nothing(empty: Shell, keyboard: int) -> None:
    os.write(keyboard, b"y\n")
    with typist(keyboard, "n\n") as begins:
        operator = Operator(empty, begins)
        operator.start()
        said = empty(*operator.words)
        operator.join()
    assert "rossec: error: the digits were not confirmed" in said.err
    assert not (operator.node / "ca.pem").exists()


@pytest.mark.parametrize("label", [False, True])
def test_a_picture_with_a_secret_is_for_the_owner_alone(empty: Shell, label: bool) -> None:
    picture = empty.root / "code.png"
    words = ("node", "enroll", "/robot", "--address", "127.0.0.1", "--png", str(picture))
    stopper = after(lambda: os.kill(os.getpid(), signal.SIGTERM), picture.exists)
    refused(empty(*words, *["--label", "--port", "0"] * label), "the enrollment was stopped")
    stopper.join()
    assert picture.stat().st_mode & 0o777 == (0o644 if label else 0o600)
