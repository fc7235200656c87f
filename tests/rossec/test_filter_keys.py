import stat
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from grants.errors import FilterRefused
from rossec.errors import ConfigurationError
from rossec.home import filter_key


def test_a_filter_key_is_made_once_for_its_owner_alone(tmp_path: Path) -> None:
    filters = tmp_path / "filters"
    key = filter_key(filters, "ward")
    assert len(key) == 32
    assert filter_key(filters, "ward") == key != filter_key(filters, "other")
    path = filters / "ward.key"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    with pytest.raises(FilterRefused, match="not a key name"):
        filter_key(filters, "../node")
    path.write_bytes(b"short")
    with pytest.raises(ConfigurationError, match="is not a key of 32 bytes"):
        filter_key(filters, "ward")


def test_processes_that_need_a_filter_key_at_once_get_one(tmp_path: Path) -> None:
    filters = tmp_path / "filters"
    with ThreadPoolExecutor(8) as pool:
        key_files = set(pool.map(lambda _: filter_key(filters, "people"), range(32)))
    assert len(key_files) == 1
