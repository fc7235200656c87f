"""What a running border router says of its things, in a file."""

import json
from pathlib import Path

import pytest

from rossec import clock
from rossec.border import border_router
from rossec.errors import ConfigurationError
from tests.support.border import LAMP, BorderSite
from tests.support.site import Site


async def test_it_says_who_is_there_and_no_secret(tmp_path: Path) -> None:
    async with Site(tmp_path / "site").running() as site, BorderSite(site).running() as border:
        border.allow()
        thing = border.secret_thing()
        async with thing:
            assert await thing.register()
            found = border_router.describe_status(border.router, 7)
            assert (found["at"], found["address"][0]) == (7, "::1")
            assert found["counts"]["derivations"] == 1
            assert found["things"][LAMP]["there"]
            border_router.write_status(tmp_path, found)
        text = (tmp_path / border_router.STATUS_FILE).read_text()
        assert border.files.secret(LAMP).hex() not in text
        assert border_router.read_status(tmp_path, 7 + border_router.STATUS_OLD) == json.loads(text)


def test_a_file_that_nobody_writes_any_more(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="no border router runs here"):
        border_router.read_status(tmp_path, clock.now())
    border_router.write_status(tmp_path, {"at": 7})
    assert (tmp_path / border_router.STATUS_FILE).stat().st_mode & 0o777 == 0o600
    with pytest.raises(ConfigurationError, match="no border router runs here") as caught:
        border_router.read_status(tmp_path, 8 + border_router.STATUS_OLD)
    assert "rossec border" in caught.value.hint


@pytest.mark.parametrize("content", ["", "[]", "{", '{"at": "soon"}', '{"at": null}'])
def test_a_damaged_file(tmp_path: Path, content: str) -> None:
    (tmp_path / border_router.STATUS_FILE).write_text(content)
    with pytest.raises(ConfigurationError, match="is damaged"):
        border_router.read_status(tmp_path, 7)
