"""Figures for Prometheus, scraped as it does."""

import sys
import urllib.request

import pytest

from rossec.errors import ConfigurationError
from rossec.master.metrics import Exporter

STATUS = {"calls": 5, "denials": 2, "nodes": 3, "registrations": 9, "connections": 4,
          "revocation_number": 7}  # fmt: skip


def test_they_are_served_on_loopback() -> None:
    exporter = Exporter(lambda: STATUS, 0)
    try:
        with urllib.request.urlopen(
            f"http://127.0.0.1:{exporter.port}/metrics", timeout=10
        ) as page:
            text = page.read().decode()
    finally:
        exporter.close()
    for name, value in STATUS.items():
        suffix = "_total" if name in ("calls", "denials") else ""
        assert f"rossec_master_{name}{suffix} {value}.0" in text


def test_without_the_package_the_operator_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "prometheus_client", None)
    with pytest.raises(ConfigurationError, match="prometheus-client") as caught:
        Exporter(lambda: STATUS, 0)
    assert "pip install" in caught.value.hint
