"""A socket of one's own: made for its owner alone, at a path that fits."""

import os
import socket
from pathlib import Path

import pytest

from rossec.errors import ConfigurationError, PeerUserRefused
from rossec.host.local_sockets import MAX_PATH, listen_at, raw_socket


def test_only_its_owner_may_connect(tmp_path: Path) -> None:
    path, before = tmp_path / "x.sock", os.umask(0o022)
    os.umask(before)
    with listen_at(path) as server, socket.socket(socket.AF_UNIX) as client:
        assert path.stat().st_mode & 0o777 == 0o600
        client.connect(str(path))
        connected, _ = server.accept()
        connected.close()
        with pytest.raises(OSError, match="in use"):
            listen_at(path)
    assert os.umask(before) == before, "the mask of the process is as it was"


def test_a_path_that_is_too_long_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="too long") as caught:
        listen_at(tmp_path / ("x" * MAX_PATH))
    assert "ROSSEC_HOME" in caught.value.hint


def test_the_socket_behind_a_transport_is_found() -> None:
    class Transport:
        def __init__(self, sock: object) -> None:
            self._sock = sock

    with socket.socket(socket.AF_UNIX) as sock:
        assert raw_socket(Transport(sock)) is sock
        assert raw_socket(sock) is sock
    with pytest.raises(PeerUserRefused, match="no socket"):
        raw_socket(None)
