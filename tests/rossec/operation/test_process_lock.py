from pathlib import Path

import pytest

from rossec.errors import ConfigurationError
from rossec.host.local_sockets import process_lock


def test_a_second_process_is_refused_until_the_first_ends(tmp_path: Path) -> None:
    path, busy = tmp_path / "some.lock", ConfigurationError("another one runs", "end it first")
    with process_lock(path, busy):
        second = process_lock(path, busy)
        with pytest.raises(ConfigurationError, match="another one runs") as caught, second:
            pytest.fail("two hold one lock")
        assert caught.value.hint == "end it first"
    with process_lock(path, busy):
        pass
