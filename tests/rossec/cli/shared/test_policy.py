from pathlib import Path

import pytest

from ca.errors import PathRefused
from rossec.cli.shared.context import Environment
from rossec.cli.shared.policy import read_policy
from rossec.errors import ConfigurationError
from tests.grants.policy.policies import SMALL


@pytest.fixture
def environment(tmp_path: Path) -> Environment:
    (tmp_path / "ca").mkdir(mode=0o700)
    tmp_path.chmod(0o700)
    return Environment({"ROSSEC_HOME": str(tmp_path)})


def test_the_policy_in_force_is_read_by_default(environment: Environment) -> None:
    with pytest.raises(ConfigurationError):
        read_policy(environment, None)
    path = environment.home / "ca" / "policy.yaml"
    path.write_text(SMALL)
    assert read_policy(environment, None).path == path


def test_a_policy_that_others_can_write_signs_nothing(environment: Environment) -> None:
    path = environment.home / "other.yaml"
    path.write_text(SMALL)
    path.chmod(0o666)
    assert read_policy(environment, path).path == path
    with pytest.raises(PathRefused):
        read_policy(environment, path, signs=True)
