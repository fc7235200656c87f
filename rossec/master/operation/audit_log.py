"""Connecting the audit to Python's logging, for as long as a master runs."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from ca.keys.signer import Signer
from rossec.master.operation.audit import AuditFile
from rossec.master.operation.denial_limit import DENIALS, DenialRateLimit

AUDIT: Final = "rossec.audit"


@contextmanager
def denials_limited() -> Iterator[None]:
    """Limit the rate of the lines that nodes cause."""
    limit, log = DenialRateLimit(), logging.getLogger(DENIALS)
    log.addFilter(limit)
    try:
        yield
    finally:
        log.removeFilter(limit)


@contextmanager
def audit_written(path: Path, signer: Signer) -> Iterator[None]:
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
        yield
    finally:
        log.setLevel(level)
        log.removeHandler(handler)
        handler.close()
