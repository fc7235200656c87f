"""What `rossec run` and `rossec sidecar` replace their process with."""

import json
import os
from typing import Any

import pytest


@pytest.fixture
def became(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the process would have become."""
    found: dict[str, Any] = {}

    def execve(path: str, arguments: list[str], env: dict[str, str]) -> None:
        found.update(json.loads(arguments[-1]), path=path, flags=arguments[1:-1], env=env)
        raise OSError(0, "replaced")

    monkeypatch.setattr(os, "execve", execve)
    return found
