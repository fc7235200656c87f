import asyncio
import os
import re

import pytest

from ca.certificates import from_pem
from ca.enrollment import qr
from ca.enrollment.sides import AuthorityEnrollment, AuthorityState
from ca.errors import HintedError
from rossec.cli.main import run
from rossec.enrollment import enroll
from rossec.enrollment.enroll import code_in
from rossec.home import NodeHome
from rossec.host import addresses
from tests.rossec.cli.node.operators import SITE, Operator, after
from tests.support.commands import Shell, refused
from tests.support.enrolling import clock
from tests.support.pki import Site
from tests.support.ports import free_port


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
    assert any(re.fullmatch(r"authority of home, fingerprint [0-9a-f ]{39}", line) for line in lines)
    assert any(line.startswith("/robot waits at 127.0.0.1:") for line in lines)
    assert b"<svg" in svg.read_bytes()
    home = NodeHome.of(empty.root, "/robot")
    assert home.identity(clock()).name == "/robot"
    assert home.anchor().certificate == SITE.root
    assert from_pem((home.path / "ca.pem").read_bytes()) == (SITE.root,)


def test_a_node_is_confirmed_by_the_confirm_command(empty: Shell) -> None:
    """In another shell; here from the thread of the operator, who walks to the robot."""
    codes: list[int] = []

    def walk(_: Operator, digits: str) -> None:
        typed = (("12345",), (str((int(digits) + 1) % 10**6).zfill(6),), (digits[:3], f"-{digits[3:]}"))
        codes.extend(run(("node", "confirm", "/robot", "--", *words), empty.environ) for words in typed)

    operator = Operator(empty, walk)
    operator.start()
    said = empty(*operator.words)
    operator.join()
    assert codes == [1, 1, 0]
    assert said.code == 0
    assert "rossec: error: the authority shows six digits\n" in said.err
    assert "rossec: error: these are not the digits of the offer" in said.err


def test_confirm_without_digits_shows_and_asks(empty: Shell) -> None:
    def press(*_: object) -> None:
        assert run(("node", "confirm", "/robot", "--yes"), empty.environ) == 0

    operator = Operator(empty, press)
    operator.start()
    said = empty(*operator.words)
    operator.join()
    assert said.code == 0
    assert said.out.count("digits ") == 2


def test_the_digits_may_be_typed_as_the_answer(empty: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    codes: list[int] = []

    def walk(_: Operator, digits: str) -> None:
        for answer in ("n", "", "000000", f"{digits[:3]} {digits[3:]}"):
            monkeypatch.setattr("click.prompt", lambda *_, answer=answer, **__: answer)
            codes.append(run(("node", "confirm", "/robot"), empty.environ))

    operator = Operator(empty, walk)
    operator.start()
    said = empty(*operator.words)
    operator.join()
    assert (codes, said.code) == ([1, 1, 1, 0], 0)
    assert "rossec: error: the digits were not confirmed" in said.err


def test_nothing_waits_to_be_confirmed(shell: Shell) -> None:
    for words in (("123", "456"), ()):
        said = shell("node", "confirm", "/robot", *words)
        refused(said, "no enrollment of this node is waiting", "rossec node enroll")


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


def test_a_node_is_enrolled_again_with_its_key(empty: Shell) -> None:
    """The same key, a new request: an identity is renewed by hand."""
    for _ in range(2):
        operator = Operator(empty, Operator.confirm)
        operator.start()
        assert empty(*operator.words).code == 0
        operator.join()
        operator.png.unlink()


def test_a_node_is_enrolled_by_its_label(empty: Shell) -> None:
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


def test_a_node_is_enrolled_for_anonymous_nodes(empty: Shell) -> None:
    operator = Operator(empty, Operator.confirm)
    operator.start()

    class Either(AuthorityEnrollment):
        def __init__(self, code: qr.Code, domain: str) -> None:
            super().__init__(code, domain, wildcard=True)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tests.rossec.cli.node.operators.AuthorityEnrollment", Either)
        assert empty(*operator.words, "--anonymous").code == 0
        operator.join()
    assert NodeHome.of(empty.root, "/robot").identity(clock()).covers("/robot_1_2")


def test_a_second_enrollment_of_one_node_is_refused(empty: Shell) -> None:
    png = empty.root / "code.png"
    codes: list[int] = []

    def second() -> None:
        try:
            asyncio.run(enroll.serve(empty.node("/robot"), lambda _: {}))
        except HintedError:
            codes.append(1)
        os.kill(os.getpid(), 15)

    other = after(second, png.exists)
    empty("node", "enroll", "/robot", "--address", "127.0.0.1", "--png", str(png))
    other.join()
    assert codes == [1]


def test_only_a_label_has_a_window(empty: Shell) -> None:
    refused(empty("node", "enroll", "/robot", "--for", "1h"), "--for needs --label", code=2)
    assert not empty.node("/robot").exists()


def test_the_code_has_the_configured_or_own_address(empty: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
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
    monkeypatch.setattr(addresses, "own_addresses", lambda: ["10.0.0.7", "fd00::7"])
    where, err = shown()
    assert where.startswith("10.0.0.7:")
    assert "other addresses of this host, for --address: fd00::7" in err
    monkeypatch.setattr(addresses, "own_addresses", lambda: ["10.0.0.7"])
    _, err = shown()
    assert "other addresses" not in err


def test_labels_are_written_to_a_sheet(empty: Shell) -> None:
    sheet = empty.root / "sheet.html"
    said = empty("node", "labels", "/robot", "/door", "--out", str(sheet))
    assert said.out == f"2 labels in {sheet}: print it without scaling\n"
    html = sheet.read_text()
    assert ">/robot</text>" in html
    assert ">/door</text>" in html
    said = empty("node", "labels", "/robot", "--out", str(sheet))
    assert said.out.startswith("1 label in ")
    refused(empty("node", "labels", "robot", "--out", str(sheet)), "not an absolute ROS name")


def test_a_label_of_another_key_is_refused(empty: Shell) -> None:
    for name in ("/robot", "/door"):
        empty("node", "request", name)
    request = (empty.node("/door") / "node.csr").read_bytes()
    (empty.node("/robot") / "node.csr").write_bytes(request)
    refused(empty("node", "labels", "/robot", "--out", str(empty.root / "x")), "for another key")
