"""Metrics for Prometheus, off by default, on loopback only: they reveal a site's activity."""

import asyncio
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from socket import SHUT_RDWR
from socketserver import ThreadingMixIn
from threading import Thread, Timer
from typing import Any, Final
from weakref import WeakKeyDictionary
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

from rossec.errors import ConfigurationError
from rossec.net.limits import HalfOpenCount, HalfOpenLimits, HalfOpenSlot

ADDRESS: Final = "127.0.0.1"
_LIMIT: Final = HalfOpenLimits(per_address=8, total=16)
DEADLINE: Final = 5.0  # seconds for the loop to answer
_COUNTERS: Final = {"calls": "Calls answered.", "denials": "Calls refused for want of a right."}
_GAUGES: Final = {
    "nodes": "Registered nodes.",
    "registrations": "Registrations of all kinds.",
    "connections": "Open connections, handshakes included.",
    "revocation_number": "Sequence number of the revocation list in force.",
    "domains": "Foreign domains listed.",
    "domains_number": "Sequence number of the list of domains in force.",
    "identity_expires": "When the master's own identity ends, in seconds since the epoch.",
    "renewals_waiting": "Identities that nodes asked to be renewed, without an answer yet.",
    "foreign_connections": "Open connections of nodes of other domains.",
}

Status = Callable[[], Mapping[str, Any]]


def on_loop(status: Status) -> Status:
    """`status` for other threads: called in the running loop, where its state is changed."""
    loop = asyncio.get_running_loop()

    async def requested() -> Mapping[str, Any]:
        return status()

    return lambda: asyncio.run_coroutine_threadsafe(requested(), loop).result(DEADLINE)


class MetricsCollector:
    def __init__(self, status: Status) -> None:
        self._status = status

    def collect(self) -> Iterator[Any]:
        from prometheus_client import core  # noqa: PLC0415 - an extra

        status = self._status()
        for name, text in _COUNTERS.items():
            yield core.CounterMetricFamily(f"rossec_master_{name}", text, value=status[name])
        for name, text in _GAUGES.items():
            yield core.GaugeMetricFamily(f"rossec_master_{name}", text, value=status[name])


class _Server(ThreadingMixIn, WSGIServer):
    daemon_threads = True

    def __init__(self, *arguments: Any) -> None:
        self._count = HalfOpenCount(_LIMIT)
        self._slots: WeakKeyDictionary[Any, HalfOpenSlot] = WeakKeyDictionary()
        super().__init__(*arguments)

    def verify_request(self, request: Any, client_address: Any) -> bool:
        slot = self._count.admit(client_address[0])
        if slot is not None:
            self._slots[request] = slot
            slot.close = partial(_end, request)
        return slot is not None

    def shutdown_request(self, request: Any) -> None:
        super().shutdown_request(request)
        slot = self._slots.pop(request, None)
        if slot is not None:
            slot.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        # Errors of connections are not logged.
        ...


def _end(request: Any) -> None:
    with suppress(OSError):  # it has ended
        request.shutdown(SHUT_RDWR)


class _Handler(WSGIRequestHandler):
    timeout = DEADLINE

    def handle(self) -> None:
        timer = Timer(2 * DEADLINE, _end, [self.request])
        timer.start()
        try:
            super().handle()
        finally:
            timer.cancel()

    def log_message(self, format: str, *arguments: Any) -> None:  # noqa: A002 - of the base class
        # Requests are not logged.
        ...


class MetricsExporter:
    """Serves the metrics on a loopback port, in its own thread."""

    def __init__(self, status: Status, port: int) -> None:
        try:
            import prometheus_client  # noqa: PLC0415 - an extra
        except ImportError as error:
            raise ConfigurationError(
                "metrics need the package prometheus-client", "pip install rossec[metrics]"
            ) from error
        registry = prometheus_client.CollectorRegistry()
        registry.register(MetricsCollector(status))
        try:
            application = prometheus_client.make_wsgi_app(registry)
            self._server = make_server(ADDRESS, port, application, _Server, _Handler)
        except OSError as error:
            raise ConfigurationError(
                f"metrics cannot be served on port {port}: {os.strerror(error.errno or 0).lower()}",
                "choose another port, or 0 for any",
            ) from error
        self._thread = Thread(target=self._server.serve_forever, name="metrics", daemon=True)
        self._thread.start()
        self.port: int = self._server.server_port

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
