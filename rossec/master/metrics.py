"""Figures for Prometheus, on request and on loopback only: they tell who is there and how busy."""

import asyncio
import os
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

from rossec.errors import ConfigurationError

ADDRESS: Final = "127.0.0.1"
DEADLINE: Final = 5.0  # seconds until the loop must have answered
_COUNTED: Final = {
    "calls": "Calls answered.",
    "denials": "Calls refused for want of a right.",
}
_GAUGED: Final = {
    "nodes": "Registered nodes.",
    "registrations": "Registrations of all kinds.",
    "connections": "Open connections, handshakes included.",
    "revocation_number": "Sequence number of the revocation list in force.",
}

Status = Callable[[], Mapping[str, Any]]


def of_loop(status: Status) -> Status:
    """`status` of the running loop, for other threads: it must not change while it is counted."""
    loop = asyncio.get_running_loop()

    async def asked() -> Mapping[str, Any]:
        return status()

    return lambda: asyncio.run_coroutine_threadsafe(asked(), loop).result(DEADLINE)


class Collector:
    """Asks for the status whenever it is scraped."""

    def __init__(self, status: Status) -> None:
        self._status = status

    def collect(self) -> Iterator[Any]:
        """The figures, in the form of prometheus_client."""
        from prometheus_client import core  # noqa: PLC0415 - an extra

        status = self._status()
        for name, text in _COUNTED.items():
            yield core.CounterMetricFamily(f"rossec_master_{name}", text, value=status[name])
        for name, text in _GAUGED.items():
            yield core.GaugeMetricFamily(f"rossec_master_{name}", text, value=status[name])


class Exporter:
    """Serves the figures on a port of loopback, in a thread of its own."""

    def __init__(self, status: Status, port: int) -> None:
        try:
            import prometheus_client  # noqa: PLC0415 - an extra
        except ImportError as error:
            raise ConfigurationError(
                "metrics need the package prometheus-client", "pip install rossec[metrics]"
            ) from error
        registry = prometheus_client.CollectorRegistry()
        registry.register(Collector(status))
        try:
            self._server, self._thread = prometheus_client.start_http_server(
                port, addr=ADDRESS, registry=registry
            )
        except OSError as error:
            raise ConfigurationError(
                f"metrics cannot be served on port {port}: {os.strerror(error.errno or 0).lower()}",
                "choose another port, or 0 for any",
            ) from error
        self.port: int = self._server.server_port

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
