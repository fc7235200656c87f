"""The key is unlocked before the master runs, as the how-tos do."""

import logging
from pathlib import Path

import pytest

from rossec.authority.keyservice.work import GRACE
from tests.rossec.authority.keyservice.test_work import DAY, Working


@pytest.fixture
def working(tmp_path: Path) -> Working:
    return Working(tmp_path)


def test_a_master_that_is_started_after_the_key_was_unlocked_is_no_warning(
    working: Working, caplog: pytest.LogCaptureFixture
) -> None:
    """The documented order; one that is still not there in the next round is."""
    working.reachable = False
    working.work.maintain()
    assert {record.levelno for record in caplog.records} <= {logging.INFO}
    working.now += GRACE
    working.work.maintain()
    assert "no master" in caplog.text
    assert caplog.records[-1].levelno == logging.WARNING
    caplog.clear()
    working.reachable = True
    working.work.maintain()
    working.reachable = False
    working.now += 300 * DAY
    working.work.maintain()
    assert caplog.records[0].levelno == logging.WARNING, "it was there before"
