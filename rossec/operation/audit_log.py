"""Connecting the audit to Python's logging, for as long as a program runs."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from ca.keys.signer import Signer
from rossec.operation.audit import AuditFile

AUDIT: Final = "rossec.audit"


@contextmanager
def audit_written(path: Path, signer: Signer) -> Iterator[AuditFile]:
    """Write what is logged to `rossec.audit` to the audit file at `path`.

    Raises:
        PathRefused, OSError: as of `AuditFile`.
    """
    handler = AuditFile(path, signer=signer)
    log, root = logging.getLogger(AUDIT), logging.getLogger()
    level = log.level
    log.setLevel(logging.INFO)
    for other in root.handlers:  # the other handlers write no more than without an audit
        other.setLevel(max(other.level, root.level))
    log.addHandler(handler)
    try:
        yield handler
    finally:
        log.setLevel(level)
        log.removeHandler(handler)
        handler.close()
