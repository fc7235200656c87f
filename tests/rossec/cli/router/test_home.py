from pathlib import Path

import pytest

from ca.errors import HintedError
from rossec.cli.shared.context import Environment
from rossec.cli.sites import home_of


def test_the_directory_is_that_of_rossec_or_the_one_that_was_said(tmp_path: Path) -> None:
    environment = Environment({"ROSSEC_HOME": str(tmp_path)})
    assert home_of(environment, None).path == tmp_path / "router"
    assert home_of(environment, tmp_path / "a").path == tmp_path / "a"


def test_a_home_that_others_can_write_to_is_refused(tmp_path: Path) -> None:
    tmp_path.chmod(0o777)
    with pytest.raises(HintedError):
        home_of(Environment({"ROSSEC_HOME": str(tmp_path)}), None)
