"""Metrics, scraped as by Prometheus."""

import asyncio
import contextlib
import socket
import sys
import threading
import urllib.request

import pytest

from rossec.errors import ConfigurationError
from rossec.master.operation import metrics
from rossec.master.operation.metrics import MetricsExporter, on_loop

STATUS = {
    "calls": 5,
    "denials": 2,
    "nodes": 3,
    "registrations": 9,
    "connections": 4,
    "revocation_number": 7,
    "domains": 1,
    "domains_number": 6,
    "foreign_connections": 8,
    "identity_expires": 10,
    "renewals_waiting": 11,
}


def test_metrics_are_served_on_loopback() -> None:
    exporter = MetricsExporter(lambda: STATUS, 0)
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{exporter.port}/metrics", timeout=10) as page:
            text = page.read().decode()
    finally:
        exporter.close()
    for name, value in STATUS.items():
        suffix = "_total" if name in ("calls", "denials") else ""
        assert f"rossec_master_{name}{suffix} {value}.0" in text


def test_silent_connections_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any user of the host can connect; without a limit each takes a thread and a descriptor."""
    monkeypatch.setattr(metrics._Handler, "timeout", 0.3)
    exporter = MetricsExporter(lambda: STATUS, 0)
    silent: list[socket.socket] = []
    slot = "127.0.0.1", exporter.port
    try:
        before = threading.active_count()
        silent.extend(socket.create_connection(slot, 10) for _ in range(24))
        assert threading.active_count() - before <= 16
        while True:  # a closed connection frees its slot
            with contextlib.suppress(OSError):
                uri = f"http://127.0.0.1:{exporter.port}/metrics"
                with urllib.request.urlopen(uri, timeout=10) as page:
                    assert b"rossec_master_calls_total" in page.read()
                break
    finally:
        for sock in silent:
            sock.close()
        exporter.close()


def test_a_missing_package_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "prometheus_client", None)
    with pytest.raises(ConfigurationError, match="prometheus-client") as caught:
        MetricsExporter(lambda: STATUS, 0)
    assert "pip install" in caught.value.hint


def test_a_port_in_use_is_reported() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ConfigurationError, match=f"on port {port}: address already in use"):
            MetricsExporter(lambda: STATUS, port)


async def test_the_status_is_read_in_the_loop() -> None:
    def status() -> dict[str, int]:
        assert threading.current_thread() is threading.main_thread()
        return STATUS

    requested = on_loop(status)
    assert await asyncio.to_thread(requested) == STATUS
