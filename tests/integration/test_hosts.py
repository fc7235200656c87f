"""The two hosts of a test on a machine without network namespaces."""

import os
from pathlib import Path

import pytest

from tests.support.hosts import two_hosts


def test_without_namespaces_the_hosts_are_two_addresses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a container without the capability; tests that need namespaces are skipped."""
    refusing = tmp_path / "unshare"
    refusing.write_text("#!/bin/sh\nexit 1\n")
    refusing.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    with two_hosts() as hosts:
        assert not hosts.real
        assert (hosts.near.ipv4, hosts.far.ipv4) == ("127.0.0.1", "127.0.0.2")
        assert hosts.far.at("true") == ("true",)
