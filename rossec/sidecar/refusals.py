"""Refusals that a program may not print: rosnode says "killed" whatever a node answers."""

import logging

from rossec.ros.text import printable

_log = logging.getLogger("rossec.sidecar")
_PREFIX = "rossec: "


def log_refusal(refuser: str, method: str, answer: object) -> None:
    """Warn of an answer in which rossec refuses a call; of any other: nothing."""
    match answer:
        case [code, str(status), *_] if code != 1 and status.startswith(_PREFIX):
            reason = printable(status.removeprefix(_PREFIX))
            _log.warning("%s refuses %s: %s", refuser, method, reason)
        case _:
            pass
