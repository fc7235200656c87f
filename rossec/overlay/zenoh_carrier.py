"""Unreliable messages between inboxes, through the routers: the one module that knows Zenoh.

Whoever puts is not told whether anybody received: a link acknowledges by itself. Zenoh calls back
in its own threads; here everything that arrived meanwhile wakes the loop once. What waits is
bounded for each subscription, since anybody with an account may put to an inbox that it knows.
"""

import asyncio
import logging
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from json import dumps
from threading import Lock
from time import monotonic
from typing import TYPE_CHECKING, Final, Self

from rossec.errors import OverlayUnavailable
from rossec.overlay.documents import Routers
from rossec.overlay.router_settings import client_settings

if TYPE_CHECKING:
    import zenoh


SLOW: Final = 0.02  # seconds
CALM: Final = 1.0
MOST_WAITING: Final = 4 * 1024 * 1024  # bytes, as one link may have on the way
_log = logging.getLogger("rossec.overlay.carrier")
_MOST_WAITING: Final = 16 * 1024 * 1024  # bytes for one subscription; a link sends at most 4 MiB
_OVERHEAD: Final = 256  # bytes that a message costs beside its own
_REOPEN_AFTER: Final = 1.0  # seconds between attempts
_TURN_BYTES: Final = 1024 * 1024  # delivered, then other work of the loop has its turn
_TURN_OVERHEAD: Final = 16 * 1024  # bytes that are opened in the time a message costs


class CarrierQueue:
    """Messages on their way to the session: at once, unless that would stop the loop.

    From the first put that was slow, a thread puts, until it has nothing left and was quick for a
    second. What finds no room in its queue is dropped, as Zenoh would.
    """

    def __init__(self, send: Callable[[str, bytes], None]) -> None:
        self._send = send
        self._thread: ThreadPoolExecutor | None = None
        self._lock = Lock()
        self._waiting = 0
        self._slow_until = 0.0
        self._closed = False

    def put(self, key: str, data: bytes) -> None:
        if self._waiting == 0 and monotonic() >= self._slow_until:
            self._send_timed(key, data)
        elif self._waiting + len(data) <= MOST_WAITING and not self._closed:
            if self._thread is None:
                self._thread = ThreadPoolExecutor(1, "rossec-overlay")
            with self._lock:
                self._waiting += len(data)
            self._thread.submit(self._send_queued, key, data)

    def _send_timed(self, key: str, data: bytes) -> None:
        began = monotonic()
        self._send(key, data)
        ended = monotonic()
        # A put takes microseconds until the uplink is full; then Zenoh waits 50 ms before it drops.
        if ended - began > SLOW:
            self._slow_until = ended + CALM

    def _send_queued(self, key: str, data: bytes) -> None:
        try:
            self._send_timed(key, data)
        finally:
            with self._lock:
                self._waiting -= len(data)

    def close(self) -> None:
        self._closed = True
        if self._thread is not None:
            self._thread.shutdown(wait=False, cancel_futures=True)


def open_session(settings: Mapping[str, object]) -> "zenoh.Session":
    try:
        import zenoh  # noqa: PLC0415 - as above
    except ImportError as error:
        raise OverlayUnavailable("eclipse-zenoh is not installed", "pip install rossec[overlay]") from error
    config = zenoh.Config()
    for path, value in settings.items():
        config.insert_json5(path, dumps(value))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        # Behind it is a path of the machine that built the library.
        reason = str(error).partition(" at /")[0].rstrip("!. ")
        raise OverlayUnavailable(f"Zenoh cannot begin: {reason}") from error


class CarrierSubscription:
    def __init__(self, carrier: "Carrier", key: str, callback: Callable[[bytes], None]) -> None:
        self._carrier = carrier
        self._callback: Callable[[bytes], None] | None = callback
        self.key = key
        self.waiting = 0  # bytes, not delivered yet; written by the carrier, under its lock
        self.subscriber: zenoh.Subscriber[None] | None = None  # what the present session has of it

    def deliver(self, data: bytes) -> None:
        if self._callback is None:  # closed meanwhile
            return
        try:
            self._callback(data)
        except Exception:  # noqa: BLE001 - the others of this turn are delivered all the same
            _log.exception("a message of the overlay was not handled")

    def close(self) -> None:
        if self._callback is not None:
            self._callback = None
            self._carrier.forget(self)


class Carrier:
    """The session of a relay with its routers; used on the loop that opened it."""

    def __init__(self, routers: Routers, session: "zenoh.Session") -> None:
        import zenoh  # noqa: PLC0415 - as in `open_session`

        self.routers = routers
        self._failure = zenoh.ZError
        self._loop = asyncio.get_running_loop()
        self._session = session
        self._queue = CarrierQueue(self._put)
        self._subscriptions: set[CarrierSubscription] = set()
        self._arrived: deque[tuple[CarrierSubscription, bytes]] = deque()
        self._lock = Lock()
        self._woken = False
        self._reopening: asyncio.Task[None] | None = None
        self.closed = False
        self.heard_at = self._loop.time()  # when a message arrived last, or a session was opened

    @classmethod
    async def open(cls, routers: Routers) -> Self:
        """Connect to one of the routers."""
        return cls(routers, await _open(routers))

    @property
    def router(self) -> str:
        """The locator of the router in use; empty: none, it is looked for."""
        with suppress(self._failure):  # a session that is being closed
            for link in self._session.info.links():
                return link.dst
        return ""

    # -- sending

    def put(self, key: str, data: bytes) -> None:
        """Send at most `MAX_FRAME` octets to this inbox; nobody says whether they arrive."""
        self._queue.put(key, data)

    def _put(self, key: str, data: bytes) -> None:
        with suppress(self._failure):  # the session is being replaced: one more loss
            self._session.put(key, data)

    # -- receiving

    def subscribe(self, key: str, callback: Callable[[bytes], None]) -> CarrierSubscription:
        """Call back on the loop with each message that arrives in this inbox."""
        subscription = CarrierSubscription(self, key, callback)
        self._declare(subscription)
        self._subscriptions.add(subscription)
        return subscription

    def _declare(self, subscription: CarrierSubscription) -> None:
        def receive(sample: "zenoh.Sample") -> None:  # in a thread of Zenoh's
            if str(sample.key_expr) != subscription.key:
                return  # put to a pattern: whoever did does not know this inbox
            data = sample.payload.to_bytes()
            with self._lock:
                # Anybody with an account may put to an inbox that it knows: what waits is bounded for each.
                if subscription.waiting > _MOST_WAITING:
                    return
                subscription.waiting += len(data) + _OVERHEAD
                self._arrived.append((subscription, data))
                wake, self._woken = not self._woken, True
            if wake:
                with suppress(RuntimeError):  # the loop is closed
                    self._loop.call_soon_threadsafe(self._deliver)

        try:
            subscription.subscriber = self._session.declare_subscriber(subscription.key, receive)
        except self._failure as error:
            raise OverlayUnavailable("the session with the routers is closed") from error

    def forget(self, subscription: CarrierSubscription) -> None:
        self._subscriptions.discard(subscription)
        subscriber, subscription.subscriber = subscription.subscriber, None
        if subscriber is not None:
            with suppress(self._failure):  # of a session that is gone
                subscriber.undeclare()  # type: ignore[no-untyped-call]

    def _deliver(self) -> None:
        self.heard_at = self._loop.time()
        taken: list[tuple[CarrierSubscription, bytes]] = []
        size = 0
        with self._lock:
            while self._arrived and size < _TURN_BYTES:
                subscription, data = self._arrived.popleft()
                subscription.waiting -= len(data) + _OVERHEAD
                size += len(data) + _TURN_OVERHEAD
                taken.append((subscription, data))
            self._woken = bool(self._arrived)
        if self._woken:
            self._loop.call_soon(self._deliver)
        for subscription, data in taken:
            subscription.deliver(data)

    # -- the session

    def reopen(self) -> None:
        """Replace the session until a router takes the account: nothing arrives, though it should."""
        if self._reopening is None and not self.closed:
            self._reopening = self._loop.create_task(self._replace_session(), name="rossec overlay session")

    async def _replace_session(self) -> None:
        said, session = False, None
        try:
            while session is None:
                try:
                    session = await _open(self.routers)
                except OverlayUnavailable as error:
                    if not said:
                        _log.warning("%s; trying again until one does", error)
                    said = True
                    await asyncio.sleep(_REOPEN_AFTER)
            old, self._session = self._session, session
            self.heard_at = self._loop.time()
            for subscription in list(self._subscriptions):
                subscription.subscriber = None
                self._declare(subscription)
            _log.warning("nothing came through the routers: the session was replaced")
            await asyncio.to_thread(old.close)
        except Exception:  # noqa: BLE001 - reported; the next frame that is missed begins anew
            _log.exception("the session with the routers was not replaced")
        finally:
            self._reopening = None

    async def close(self) -> None:
        self.closed = True
        if self._reopening is not None:
            self._reopening.cancel()
            await asyncio.wait([self._reopening])
            self._reopening = None  # it may have been cancelled before it began
        for subscription in list(self._subscriptions):
            subscription.close()
        self._queue.close()
        await asyncio.to_thread(self._session.close)


async def _open(routers: Routers) -> "zenoh.Session":
    settings = client_settings(routers)
    opening = asyncio.get_running_loop().run_in_executor(None, open_session, settings)
    try:
        return await asyncio.shield(opening)
    except asyncio.CancelledError:
        opening.add_done_callback(_discard)
        raise
    except OverlayUnavailable as error:
        if isinstance(error.__cause__, ImportError):
            raise
        raise OverlayUnavailable(
            f"no router takes the account {routers.account}: {', '.join(routers.locators)}",
            "does a router run there, can this host reach it, and is the account file the newest of"
            " its operator?",
        ) from error


def _discard(opening: "asyncio.Future[zenoh.Session]") -> None:
    if not opening.cancelled() and opening.exception() is None:
        opening.result().close()  # type: ignore[no-untyped-call]
