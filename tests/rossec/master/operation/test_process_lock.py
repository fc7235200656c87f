from pathlib import Path

import pytest

from rossec.errors import ConfigurationError
from rossec.master.operation.process_lock import process_lock


def test_a_second_master_is_refused_until_the_first_ends(tmp_path: Path) -> None:
    with process_lock(tmp_path):
        second = process_lock(tmp_path)
        with pytest.raises(ConfigurationError, match="another master runs from") as caught, second:
            pytest.fail("two masters run from one directory")
        assert "end it first" in (caught.value.hint or "")
    with process_lock(tmp_path):
        pass
