"""Refusals in the log of a sidecar."""

import logging

import pytest

from rossec.sidecar.refusals import log_refusal


def test_refusals_are_logged_on_one_line(caplog: pytest.LogCaptureFixture) -> None:
    log_refusal("the master", "getParam", [-1, "rossec: no grant\nof param-get", 0])
    assert [record.levelno for record in caplog.records] == [logging.WARNING]
    assert "the master refuses getParam: no grant" in caplog.text
    assert len(caplog.messages[0].splitlines()) == 1


@pytest.mark.parametrize(
    "answer",
    [[1, "rossec: fine", 0], [-1, "not known", 0], [0, 7, 0], [], None, b"<xml/>"],
    ids=["success", "of-the-program", "no-text", "empty", "none", "not-parsed"],
)
def test_refusals_of_others_are_not_logged(
    caplog: pytest.LogCaptureFixture, answer: object
) -> None:
    log_refusal("the master", "getParam", answer)
    assert caplog.messages == []
