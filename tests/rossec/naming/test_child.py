"""The process that forks for each request: what it answers, and what it cannot do."""

import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable

import pytest

from rossec.errors import NameUndefined, RossecError, RulesExceeded, RulesNotConfined
from rossec.host import sandbox
from rossec.naming import child, requests
from rossec.naming.requests import NameKind, NameRequest
from rossec.naming.xslt import answer
from tests.rossec.naming.stylesheets import NODE, PHONE, RULES, request

BODY = requests.write_request(request(RULES))
NAME = "/smartphones/schneider/htc_desire"


def test_it_says_that_it_is_ready_and_answers_until_there_are_no_more_requests() -> None:
    done = subprocess.run(
        [sys.executable, "-I", "-m", "rossec.naming.child"],
        input=2 * requests.frame(BODY),
        capture_output=True,
        check=True,
        timeout=60,
        env={},
    )
    answer = requests.frame(requests.write_names([NAME]))
    assert done.stdout == requests.frame(requests.READY) + 2 * answer
    assert done.stderr == b""


def test_a_frame_that_is_too_long_ends_it() -> None:
    done = subprocess.run(
        [sys.executable, "-I", "-m", "rossec.naming.child"],
        input=b"\xff\xff\xff\xff" + b"a" * 99,
        capture_output=True,
        check=False,
        timeout=60,
        env={},
    )
    assert (done.returncode, done.stderr) == (1, b"")


def test_a_request_is_answered_by_a_process_of_its_own() -> None:
    assert requests.read_names(bytes(child.ask(bytearray(BODY))), 1) == [NAME]


def test_a_request_that_is_malformed_is_an_error() -> None:
    with pytest.raises(RulesExceeded, match="a request of another form"):
        requests.read_names(bytes(child.ask(bytearray(b"\0"))), 1)


def keeping(kept: list[bytearray], ask: Callable[[bytearray], bytearray]) -> Callable[[bytearray], bytearray]:
    def asked(body: bytearray) -> bytearray:
        kept.extend((body, ask(body)))
        return kept[-1]

    return asked


def test_nothing_is_left_of_a_request(monkeypatch: pytest.MonkeyPatch) -> None:
    kept: list[bytearray] = []
    monkeypatch.setattr(child, "ask", keeping(kept, child.ask))
    source, sink = os.pipe()
    own, answers = os.pipe()
    os.write(sink, requests.frame(BODY))
    os.close(sink)
    child.serve(source, answers)
    os.close(answers)
    head = os.read(own, requests.HEAD)
    assert requests.read_names(os.read(own, requests.size(head, 4096)), 1) == [NAME]
    os.close(own)
    os.close(source)
    assert kept
    assert not any(any(each) for each in kept)
    with pytest.raises(ChildProcessError):
        os.waitpid(-1, os.WNOHANG)  # no process is left


def test_a_process_that_dies_or_says_nothing_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def dies(_: bytes) -> bytes:
        os.kill(os.getpid(), signal.SIGKILL)
        return b""

    def silent(_: bytes) -> bytes:
        return b""

    def talks(_: bytes) -> bytes:
        return b"a" * (requests.MAX_ANSWER + 100_000)

    monkeypatch.setattr(child, "restrict", lambda *_: None)
    for answered in (dies, silent, talks):
        monkeypatch.setattr(child, "_answered", answered)
        with pytest.raises(RulesExceeded, match="more time or memory than allowed") as caught:
            requests.read_names(bytes(child.ask(bytearray(BODY))), 1)
        assert caught.value.hint == "2 s and 256 MB are allowed for one request"


def test_no_memory_for_an_answer_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def answer(_: NameRequest) -> bytes:
        raise MemoryError

    monkeypatch.setattr(child, "answer", answer)
    assert child._answered(BODY) == b""


def test_a_name_that_is_not_there_is_an_error() -> None:
    asked = NameRequest(RULES, PHONE, (NODE, (NameKind.TOPIC, "none")))
    found = requests.read_names(bytes(child.ask(bytearray(requests.write_request(asked)))), 2)
    assert found[0] == NAME
    assert isinstance(found[1], NameUndefined)


def forked(monkeypatch: pytest.MonkeyPatch, action: Callable[[], object]) -> str:
    """What `action` says, done in the process for a request."""

    def answered(_: bytes) -> bytes:
        try:
            return repr(action()).encode()
        except BaseException as error:  # noqa: BLE001 - whatever it is, it is the answer
            return repr(error).encode()

    monkeypatch.setattr(child, "_answered", answered)
    return bytes(child.ask(bytearray(BODY))).decode("latin-1")


@pytest.mark.parametrize(
    "action",
    [
        os.fork,
        lambda: os.open("/dev/null", os.O_RDONLY),
        lambda: os.open("/tmp/x", os.O_WRONLY | os.O_CREAT),
        lambda: os.kill(os.getpid(), 0),
        lambda: os.kill(os.getppid(), signal.SIGKILL),
        lambda: __import__("socket").socket(),
        lambda: os.execv("/bin/true", ["/bin/true"]),
        os.pipe,
        lambda: resource.setrlimit(resource.RLIMIT_CPU, (9, 9)),
        lambda: os.read(0, 1),
        lambda: os.write(1, b"a"),
        lambda: os.write(2, b"a"),
    ],
)
def test_the_process_for_a_request_can_only_compute(
    monkeypatch: pytest.MonkeyPatch, action: Callable[[], object]
) -> None:
    said = forked(monkeypatch, action)
    assert said.startswith(("PermissionError", "OSError(9,", "ValueError")), said


def test_its_time_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    def forever() -> None:
        while True:
            pass

    monkeypatch.setattr(child, "CPU", 1)
    with pytest.raises(RulesExceeded):
        requests.read_names(forked(monkeypatch, forever).encode("latin-1"), 1)


def test_what_it_is_restricted_to(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same steps as in the process itself, which nothing can look into."""
    limits: dict[int, object] = {}
    closed: list[tuple[int, int]] = []
    calls: list[str] = []
    monkeypatch.setattr(resource, "setrlimit", limits.__setitem__)
    monkeypatch.setattr(os, "closerange", lambda *between: closed.append(between))
    monkeypatch.setattr(sandbox, "allow_only", calls.extend)
    monkeypatch.setattr(sandbox, "read_only", lambda paths: None)
    monkeypatch.setattr(sandbox, "LIBC", NoDeath())
    monkeypatch.setattr(os, "nice", lambda _: 0)
    child.restrict(7, os.getppid())
    assert closed == [(0, 7), (8, child.FILES)]
    assert limits == {
        resource.RLIMIT_CPU: (2, 2),
        resource.RLIMIT_NPROC: (0, 0),
        resource.RLIMIT_NOFILE: (0, 0),
    }
    assert sandbox.FORK not in calls
    assert not {"kill", "prctl", "prlimit64", "readv", "wait4"} & set(calls)
    calls.clear()
    child.confine()
    assert limits[resource.RLIMIT_AS] == (child.MEMORY, child.MEMORY)
    assert limits[resource.RLIMIT_FSIZE] == (0, 0)
    assert closed[-1] == (3, child.FILES)
    assert sandbox.FORK in calls


class NoDeath:
    """Instead of the C library: this process stays as it is."""

    code = 0

    def prctl(self, *_: object) -> int:
        return self.code


def test_a_process_that_nobody_waits_for_does_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    libc = NoDeath()
    monkeypatch.setattr(sandbox, "LIBC", libc)
    with pytest.raises(OSError, match="nobody waits"):
        child.restrict(7, os.getpid())
    libc.code = -1
    with pytest.raises(OSError, match="prctl"):
        child.restrict(7, os.getppid())


@pytest.fixture
def said(monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    """What `main` writes, which serves nothing here."""
    written: list[bytes] = []
    monkeypatch.setattr(child, "_write", lambda _, data: written.append(bytes(data)))
    monkeypatch.setattr(child, "serve", lambda *_: None)
    return written


def test_it_says_why_it_cannot_be_confined(monkeypatch: pytest.MonkeyPatch, said: list[bytes]) -> None:
    def confine() -> None:
        raise OSError("no filter of system calls is known for armv7l")

    monkeypatch.setattr(child, "confine", confine)
    child.main()
    (first,) = said
    with pytest.raises(RulesNotConfined, match="is known for armv7l") as caught:
        requests.read_names(first[requests.HEAD :], 0)
    assert "x86_64 or aarch64" in caught.value.hint


def test_it_is_ready_once_it_is_confined(monkeypatch: pytest.MonkeyPatch, said: list[bytes]) -> None:
    done: list[str] = []
    monkeypatch.setattr(child, "confine", lambda: done.append("confined"))
    child.main()
    assert (done, said) == (["confined"], [requests.frame(requests.READY)])


def test_the_first_answer_is_for_all_that_is_loaded_later() -> None:
    first, second = requests.read_names(answer(child._WARM_UP), 2)
    assert first == "c"
    assert isinstance(second, RossecError)
