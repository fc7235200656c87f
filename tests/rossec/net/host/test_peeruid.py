"""Who is at the other end of a connection within this host."""

import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final

import pytest

from rossec.errors import PeerUserRefused
from rossec.host import local_sockets
from rossec.host.local_sockets import Holder, holder_in, require_user, user_of

HEAD: Final = "  sl  local_address rem_address   st ..."
V4: Final = "0100007F:1F90 0100007F:A0B0"
V6: Final = "00000000000000000000000001000000:1F90 00000000000000000000000001000000:A0B0"
MAPPED: Final = "0000000000000000FFFF00000100007F:1F90 0000000000000000FFFF00000100007F:A0B0"
NEAR: Final = ("127.0.0.1", 0x1F90)
FAR: Final = ("127.0.0.1", 0xA0B0)


def row(pair: str = V4, state: str = "01", uid: int = 1000, inode: int = 77) -> str:
    rest = "00000000:00000000 00:00000000 00000000"
    return f"   0: {pair} {state} {rest} {uid:>5}        0 {inode} 1 0000000000000000 20 4 30 10 -1"


def table(*rows: str) -> str:
    return "\n".join((HEAD, *rows)) + "\n"


little_endian = pytest.mark.skipif(sys.byteorder != "little", reason="rows of such a machine")


@little_endian
@pytest.mark.parametrize(
    ("pair", "local", "remote"),
    [
        (V4, NEAR, FAR),
        (MAPPED, NEAR, FAR),
        (V4, ("::ffff:127.0.0.1", 0x1F90), ("::ffff:127.0.0.1", 0xA0B0)),
        (V6, ("::1", 0x1F90), ("::1", 0xA0B0)),
    ],
)
def test_the_row_is_found(pair: str, local: tuple[str, int], remote: tuple[str, int]) -> None:
    other = row(V4.replace("1F90", "1F91"), uid=5)
    assert holder_in([table(other), table(row(pair))], local, remote) == Holder(1000, 77)
    assert holder_in([table(row(pair))], remote, local) is None


@little_endian
@pytest.mark.parametrize(
    "rows",
    [
        [],
        [row(state="06", uid=0, inode=0)],  # TIME_WAIT
        [row(uid=0, inode=0)],  # closed by its program, or not accepted yet
        [row(state="0A")],
        [row(state="05")],
        [row(), row(MAPPED, uid=1001)],  # two answers are none
        ["", "garbage", row()[:60]],
    ],
)
def test_other_rows_do_not_match(rows: list[str]) -> None:
    assert holder_in([table(*rows)], NEAR, FAR) is None


@contextmanager
def pair(family: int, address: str, client: int | None = None) -> Iterator[list[socket.socket]]:
    with ExitStack() as stack:
        dual = family == socket.AF_INET6 and address == "::"
        server = socket.create_server((address, 0), family=family, dualstack_ipv6=dual)
        stack.enter_context(server)
        remote = stack.enter_context(socket.socket(client or family))
        remote.connect(("127.0.0.1" if dual else address, server.getsockname()[1]))
        local, _ = server.accept()
        stack.enter_context(local)
        yield [local, remote]


@pytest.mark.parametrize(
    ("family", "address", "client"),
    [
        (socket.AF_INET, "127.0.0.1", None),
        (socket.AF_INET6, "::1", None),
        (socket.AF_INET6, "::", socket.AF_INET),
    ],
)
def test_the_kernel_knows_this_user(family: int, address: str, client: int | None) -> None:
    with pair(family, address, client) as (local, remote):
        assert user_of(local) == user_of(remote) == os.getuid()
        assert require_user(local, {os.getuid()}) == os.getuid()
        with pytest.raises(PeerUserRefused, match="may not use this connection"):
            require_user(local, {os.getuid() + 1})
        remote.close()
        with pytest.raises(PeerUserRefused, match="belongs to no program"):
            user_of(local)


def test_a_unix_socket_tells_its_user() -> None:
    local, remote = socket.socketpair()
    with local, remote:
        assert require_user(local, {os.getuid()}) == os.getuid()
        with pytest.raises(PeerUserRefused):
            require_user(local, ())


def test_the_overflow_user_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    overflow = tmp_path / "overflowuid"
    overflow.write_text(f"{os.getuid()}\n")
    monkeypatch.setattr(local_sockets, "OVERFLOW", overflow)
    local, remote = socket.socketpair()
    with local, remote, pytest.raises(PeerUserRefused):
        require_user(local, {os.getuid()})


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
def test_another_user_is_identified() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        where = server.getsockname()[:2]
        code = f"import socket; socket.create_connection({where}).recv(1)"
        child = subprocess.Popen([sys.executable, "-I", "-c", code], user=1234)
        try:
            local, _ = server.accept()
            with local:
                assert user_of(local) == 1234
                with pytest.raises(PeerUserRefused, match="user 1234"):
                    require_user(local, {0})
        finally:
            child.wait(30)


def test_a_kernel_that_cannot_be_asked_still_has_its_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    def unavailable(*_: object) -> None:
        raise OSError("no such protocol")

    monkeypatch.setattr(local_sockets, "find", unavailable)
    monkeypatch.setattr(local_sockets, "listener", unavailable)
    with pair(socket.AF_INET, "127.0.0.1") as (local, remote):
        inode = os.fstat(remote.fileno()).st_ino
        assert local_sockets.holder_of(local) == (os.getuid(), inode)
        place = local.getsockname()[:2]
        with socket.create_server(("127.0.0.2", place[1])):  # another place
            (holder,) = local_sockets.listeners(place)
        assert holder.user == os.getuid()
        remote.close()
        with pytest.raises(PeerUserRefused):
            local_sockets.holder_of(local)


def test_a_socket_without_a_holder_has_no_user(monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel shows user 0 for it, which is wrong."""
    entry = local_sockets.SocketEntry(1, (b"", 0), (b"", 0), 0, 0)
    monkeypatch.setattr(local_sockets, "find", lambda *_: entry)
    monkeypatch.setattr(local_sockets, "listener", lambda _: entry)
    with pair(socket.AF_INET, "127.0.0.1") as (local, _), pytest.raises(PeerUserRefused):
        local_sockets.holder_of(local)
    assert local_sockets.listeners(("127.0.0.1", 1)) == []


@pytest.mark.parametrize("asked", [True, False])
def test_the_holder_of_an_ipv6_listener(monkeypatch: pytest.MonkeyPatch, asked: bool) -> None:
    """The kernel's answer, and what its tables say: a listener of IPv4 alone is beside the way."""
    if not asked:

        def unavailable(*_: object) -> None:
            raise OSError("no such protocol")

        monkeypatch.setattr(local_sockets, "listener", unavailable)
    with socket.create_server(("::1", 0), family=socket.AF_INET6) as server:
        port = server.getsockname()[1]
        with socket.create_server(("127.0.0.1", port)):
            (holder,) = local_sockets.listeners(("::1", port))
        assert holder == (os.getuid(), os.fstat(server.fileno()).st_ino)


def test_a_unix_socket_names_process_and_user() -> None:
    one, other = socket.socketpair()
    with one, other:
        assert local_sockets.unix_peer(one) == (os.getpid(), os.getuid())
