import json
import logging
from pathlib import Path

import pytest

from ca.keys.private_keys import generate
from ca.keys.signing import KeySigner
from rossec.host.audit import AUDIT, audit_written


@pytest.fixture
def signer() -> KeySigner:
    return KeySigner(generate())


def test_the_audit_is_written_while_the_context_lasts(tmp_path: Path, signer: KeySigner) -> None:
    log, path = logging.getLogger(AUDIT), tmp_path / "audit.log"
    level, handlers = log.level, list(log.handlers)
    with audit_written(path, signer):
        log.info("the master began")
    log.info("the master ended")
    texts = [json.loads(line)["text"] for line in path.read_text().splitlines()]
    assert texts == ["the audit begins", "the master began"]
    assert (log.level, log.handlers) == (level, handlers)


def test_other_handlers_write_no_more_than_without_an_audit(
    tmp_path: Path, signer: KeySigner, monkeypatch: pytest.MonkeyPatch
) -> None:
    root, other = logging.getLogger(), logging.Handler()
    monkeypatch.setattr(root, "handlers", [other])
    monkeypatch.setattr(root, "level", logging.WARNING)
    with audit_written(tmp_path / "audit.log", signer):
        assert other.level == logging.WARNING
