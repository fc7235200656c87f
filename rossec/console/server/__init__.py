"""The console as processes: the supervisor, the web process, and what guards its pages."""

from rossec.console.server.control import WebSettings
from rossec.console.server.serving import PLACE, ConsoleServer, check_peer
from rossec.console.server.supervisor import (
    PreviewProcess,
    WebOptions,
    check_enrolled,
    settings_for,
    supervise,
)

__all__ = [
    "PLACE",
    "ConsoleServer",
    "PreviewProcess",
    "WebOptions",
    "WebSettings",
    "check_enrolled",
    "check_peer",
    "settings_for",
    "supervise",
]
