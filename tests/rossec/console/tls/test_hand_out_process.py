import http.client
import os
import socket
import time
from contextlib import suppress

import pytest

from rossec.console.tls.hand_out import FILE
from rossec.console.tls.hand_out_process import handing_out
from rossec.errors import ConfigurationError
from tests.support.console_tls import new_authority

ORIGIN = "https://rossec.local:7411"
HERE = ("127.0.0.1",)
CERTIFICATE = new_authority().data


def free_port() -> int:
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        return int(sock.getsockname()[1])


def ask(port: int, method: str = "GET", path: str = FILE) -> tuple[int, bytes, str]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    try:
        connection.request(method, path, headers={"Host": "evil.example"})
        answer = connection.getresponse()
        return answer.status, answer.read(), answer.headers.get("Server", "")
    finally:
        connection.close()


def is_closed(port: int) -> bool:
    with suppress(OSError), socket.create_connection(("127.0.0.1", port), 5):
        return False
    return True


def test_a_process_of_its_own_hands_it_out_while_it_is_wanted() -> None:
    port = free_port()
    with handing_out(CERTIFICATE, ORIGIN, HERE, os.environ, port):
        assert ask(port) == (200, CERTIFICATE, "")
        assert ask(port, path="/")[0] == 200
        assert ask(port, "POST")[0] == 405
        assert ask(port, path="/login")[0] == 404
    assert is_closed(port)


def test_it_ends_by_itself() -> None:
    port = free_port()
    with handing_out(CERTIFICATE, ORIGIN, HERE, os.environ, port, seconds=1.0):
        end = time.monotonic() + 30
        while not is_closed(port):
            assert time.monotonic() < end
            time.sleep(0.1)


def test_a_port_in_use_is_said() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with (
            pytest.raises(ConfigurationError, match="cannot listen"),
            handing_out(CERTIFICATE, ORIGIN, HERE, os.environ, port),
        ):
            raise AssertionError
