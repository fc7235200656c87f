"""Transports with rospy's interface that only record their calls."""

import threading
from io import BytesIO
from types import SimpleNamespace
from typing import Any


class Sock:
    def __init__(self, connection: object = None) -> None:
        self.connection = connection
        self.units: list[bytes] = []
        self.gate = threading.Event()
        self.gate.set()
        self.error: Exception | None = None
        self.at_once = False
        self.unsent = False
        self.service_filter: Any = None

    def try_send(self, data: bytes) -> bool:
        if self.at_once:
            self.send_unit(data)
        return self.at_once

    def send_unit(self, *pieces: Any) -> None:
        self.gate.wait(30)
        if self.error is not None:
            raise self.error
        self.units.append(b"".join(map(bytes, pieces)))


def transport(connection: object = None) -> Any:
    made: Any = SimpleNamespace(
        socket=Sock(connection),
        protocol=None,
        done=False,
        stat_bytes=0,
        stat_num_msg=0,
        endpoint_id="/x",
        callback=None,
        write_buff=BytesIO(),
    )

    def close() -> None:
        made.done = True
        if made.callback is not None:
            made.callback(made)

    made.close = close
    made.set_cleanup_callback = lambda callback: setattr(made, "callback", callback)
    return made
