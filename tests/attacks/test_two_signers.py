"""Two operators at one authority at the same moment: no revocation may be lost between them.

An attacker that knows when one operator signs makes another one sign too (R13 of attacks.md): a
revocation that is recorded but in no list leaves a stolen key valid.
"""

import asyncio
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import ExitStack, closing, suppress
from pathlib import Path

import pytest

from ca.certificates import Renewal, sign_renewal
from ca.errors import HintedError
from ca.keys import private_keys
from ca.keys.signing import KeySigner
from ca.revocation.lists import MAX_ENTRIES, RevocationList, TreeEntries, is_tree, sign_list
from ca.revocation.trust_status import open_statement
from ca.store.record import CertificateRow
from ca.svid import build_request
from rossec.authority.home import AuthorityHome
from rossec.authority.renewals import renew
from rossec.home import NodeHome
from rossec.master.server.server import master_of
from rossec.ros.names import MASTER
from tests.support.attacker import call
from tests.support.commands import PASSPHRASE, Shell

NOW = int(time.time())
SIGNERS, ROUNDS = 3, 15
DAY = 86400


@pytest.fixture
def home(tmp_path: Path) -> AuthorityHome:
    return AuthorityHome.create(tmp_path / "home", "home", PASSPHRASE, NOW)


def names(rounds: int) -> list[list[str]]:
    return [[f"/n{turn:03}{who}" for who in range(SIGNERS)] for turn in range(rounds)]


def enroll(home: AuthorityHome, many: list[str]) -> dict[str, bytes]:
    """Identities in the record alone: no test here reads the certificates."""
    known = {name: name.encode().rjust(32, b"k") for name in many}
    with closing(home.store()) as store:
        for serial, (name, key) in enumerate(known.items(), 1):
            row = CertificateRow(serial, name, key, b"der", NOW, NOW + DAY)
            store.add_certificate(row, NOW)
    return known


@pytest.fixture
def operators(home: AuthorityHome) -> Iterator[list[subprocess.Popen[str]]]:
    command = [sys.executable, "-m", "tests.support.signer", str(home.path.parent)]
    with ExitStack() as stack:
        made = [
            stack.enter_context(
                subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            )
            for _ in range(SIGNERS)
        ]
        for process in made:
            stack.callback(process.kill)
        for process in made:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
        yield made


def at_once(operators: list[subprocess.Popen[str]], victims: list[str]) -> list[str]:
    """Each operator revokes another node, all at the same moment; their outputs."""
    for process, name in zip(operators, victims, strict=True):
        assert process.stdin is not None
        process.stdin.write(f"revoke {name}\n")
        process.stdin.flush()
    return [process.stdout.readline().strip() for process in operators if process.stdout]


def listed(home: AuthorityHome) -> frozenset[bytes]:
    """What the newest signed statement revokes, a tree by its own entries."""
    data = home.revocation_list()
    if is_tree(data):
        return TreeEntries.read(home.newest_statement()[1]).entries
    found = open_statement(data, home.anchor().public_key)
    assert isinstance(found, RevocationList)
    return found.entries


@pytest.mark.attack("two-signers")
@pytest.mark.timeout(300)
@pytest.mark.parametrize("before", [0, MAX_ENTRIES - SIGNERS], ids=["list", "becomes a tree"])
def test_simultaneous_operators_lose_no_revocation(
    home: AuthorityHome, operators: list[subprocess.Popen[str]], before: int
) -> None:
    with closing(home.store()) as store:
        for number in range(before):
            store.revoke(number.to_bytes(32), "long ago", NOW)
    rounds = names(ROUNDS if not before else 3)
    known = enroll(home, [name for victims in rounds for name in victims])
    numbers: list[str] = []
    for victims in rounds:
        numbers += at_once(operators, victims)
        assert {known[name] for name in victims} <= listed(home), numbers[-SIGNERS:]
    assert [text.partition(" ")[0] for text in numbers] == ["list"] * len(numbers)
    assert len(set(numbers)) == len(numbers), "a number was signed twice"
    with closing(home.store()) as store:
        store.log.audit(home.own_key())


@pytest.fixture
def shell(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Shell:
    made = Shell(tmp_path / "shell", capsys)
    AuthorityHome.create(made.root, "home", PASSPHRASE, NOW)
    return made


@pytest.fixture
async def master(shell: Shell) -> AsyncIterator[str]:
    """The running master of `shell`; its URI."""
    shell.enroll(MASTER)
    newest = AuthorityHome.at(shell.root).revocation_list()
    server = master_of(NodeHome.of(shell.root, MASTER), host="127.0.0.1", port=0, newest=newest, now=NOW)
    await server.start()
    yield server.uri
    await server.close()


def lose(shell: Shell, name: str) -> None:
    """A revocation that is in the record but not in the list, as an old version could leave it."""
    opened = AuthorityHome.at(shell.root).unlock(PASSPHRASE)
    (key,) = opened.store.unrevoked_keys(name, int(time.time()))
    opened.store.revoke(key, "lost", NOW)
    number = opened.store.next_number()
    data = sign_list(opened.signer, RevocationList(*number, NOW, NOW + DAY, frozenset({b"w" * 32})))
    opened.store.save_list(number, data, NOW)
    opened.store.close()


def no_input(*_: object, **__: object) -> str:
    """No input at the terminal."""
    raise EOFError


@pytest.mark.attack("two-signers")
async def test_a_lost_revocation_is_listed_later(
    shell: Shell, master: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("getpass.getpass", no_input)
    shell.enroll("/thief")
    lose(shell, "/thief")
    stolen = NodeHome.of(shell.root, "/thief").credentials()

    async def connects() -> bool:
        try:
            answer = await call(master, stolen, "getUri", "/thief")
        except HintedError:
            return False
        return isinstance(answer, list) and answer[0] == 1

    def publish(*more: str) -> str:
        said = shell("ca", "publish", "--master", master, *more)
        return said.out + said.err

    assert await connects()
    said = await asyncio.to_thread(publish)  # no passphrase is typed
    assert "1 revocation in no signed list yet" in said
    assert "the master has the newest list" not in said
    assert await connects()
    said = await asyncio.to_thread(publish, "--passphrase-file", str(shell.secret))
    assert "the master has the newest list" in said
    assert not await connects()
    assert AuthorityHome.at(shell.root).count_unlisted(NOW) == 0


@pytest.mark.attack("revoked-while-renewing")
def test_a_key_that_is_revoked_while_it_renews_gets_no_successor(home: AuthorityHome) -> None:
    """The revocation comes after the renewal was checked, and before its successor is recorded."""
    opened, other = home.unlock(PASSPHRASE), home.unlock(PASSPHRASE)
    other.store.database.connection.execute("PRAGMA busy_timeout = 0")
    node = NodeHome.of(home.path.parent, "/thief")
    node.create_request("home")
    node.install(opened.issue(node.request(), NOW, DAY), NOW)
    due = NOW + DAY * 3 // 4
    fresh = build_request(KeySigner(private_keys.generate()), "home", "/thief")
    asked = sign_renewal(node.signer(), node.credentials().chain, fresh, due)
    sign, revoked = opened.authority.renew, []

    def meanwhile(renewal: Renewal, *, now: int, serial: int, lifetime: int = DAY) -> bytes:
        with suppress(HintedError):  # the other command has to wait
            revoked.append(other.revoke_identity("/thief", "stolen", due))
        return sign(renewal, now=now, serial=serial, lifetime=lifetime)

    opened.authority.renew = meanwhile  # type: ignore[method-assign]
    with suppress(HintedError):
        renew(opened, asked, due)
    if not revoked:
        other.revoke_identity("/thief", "stolen", due)
    assert other.store.unrevoked_keys("/thief", due) == frozenset()
