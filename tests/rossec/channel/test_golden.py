"""The wire format does not change by accident."""

import json

from tests.support.golden import FILE, transcripts


def test_the_golden_transcripts() -> None:
    stored = json.loads(FILE.read_text())
    assert len(stored) == 3
    assert transcripts() == stored
