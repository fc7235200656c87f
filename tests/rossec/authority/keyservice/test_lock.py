"""One service at a time, and none while a backup is restored."""

from pathlib import Path

import pytest

from rossec.authority.keyservice.client import LOCK, service_lock
from rossec.errors import ConfigurationError


def test_a_second_service_is_refused(tmp_path: Path) -> None:
    with service_lock(tmp_path):
        assert (tmp_path / LOCK).stat().st_mode & 0o777 == 0o600
        second = service_lock(tmp_path)
        with pytest.raises(ConfigurationError, match="service runs from") as caught, second:
            pytest.fail("two services hold one key")
        assert "end it first" in caught.value.hint
    with service_lock(tmp_path):
        pass
