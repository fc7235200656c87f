"""Notifications to the service manager."""

import socket
from pathlib import Path

import pytest

from rossec.host.runner import READY, notify


@pytest.mark.parametrize("abstract", [False, True])
def test_the_manager_is_notified(tmp_path: Path, abstract: bool) -> None:
    name = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(f"\0{name}" if abstract else name)
        assert notify(READY, {"NOTIFY_SOCKET": f"@{name}" if abstract else name})
        assert manager.recv(100) == b"READY=1"


@pytest.mark.parametrize("address", [None, "", "relative", "/nowhere/at/all"])
def test_a_manager_that_does_not_listen_is_ignored(address: str | None) -> None:
    assert not notify(READY, {} if address is None else {"NOTIFY_SOCKET": address})
