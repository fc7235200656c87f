import json
import logging

import pytest

from rossec.host.runner import JsonFormatter, log_as_json


def test_a_line_of_the_log_is_json() -> None:
    record = logging.makeLogRecord({"msg": "%s\nforged", "args": ("x",), "levelname": "INFO"})
    entry = json.loads(JsonFormatter().format(record))
    assert (entry["text"], entry["level"]) == ("x\\u000aforged", "info")
    with pytest.raises(ValueError, match="inside") as caught:
        int("inside")
    record.exc_info = caught._excinfo
    assert "ValueError: invalid" in json.loads(JsonFormatter().format(record))["traceback"]


def test_the_root_logger_writes_json_to_stderr(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    root = logging.getLogger()
    monkeypatch.setattr(root, "handlers", [])
    monkeypatch.setattr(root, "level", root.level)
    log_as_json()
    logging.getLogger("rossec.master").info("started")
    assert json.loads(capsys.readouterr().err)["logger"] == "rossec.master"
