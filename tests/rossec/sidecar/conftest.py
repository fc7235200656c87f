from pathlib import Path

import pytest

from tests.rossec.sidecar.playbook import Stage
from tests.support.site import Site


@pytest.fixture
def stage(tmp_path: Path) -> Stage:
    site = Site(tmp_path / "site")
    site.enroll("/viewer")
    return Stage(site)
