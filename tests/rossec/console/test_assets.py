"""Static files: under their digest, of the right type, small."""

import pytest

from rossec.console.app import IMMUTABLE
from rossec.console.rendering import STATIC_FOLDER, asset_path, assets
from tests.support.consolepages import Browser


@pytest.fixture(autouse=True)
def _read_anew() -> None:
    assets.cache_clear()


@pytest.mark.parametrize("name", sorted(path.name for path in STATIC_FOLDER.iterdir()))
def test_a_file_is_served_under_its_digest(name: str) -> None:
    answer = Browser().get(asset_path(name))
    assert answer.status_code == 200
    assert answer.content == (STATIC_FOLDER / name).read_bytes()
    assert answer.headers["cache-control"] == IMMUTABLE
    kind = answer.headers["content-type"].partition(";")[0]
    expected = {
        ".css": "text/css",
        ".js": "text/javascript",
        ".svg": "image/svg+xml",
        ".webmanifest": "application/manifest+json",
    }
    assert kind == expected[(STATIC_FOLDER / name).suffix]


def test_another_digest_or_name_is_none() -> None:
    path = asset_path("style.css")
    for other in (path.replace("style.css", "no.css"), "/static/0000000000000000/style.css"):
        answer = Browser().get(other)
        assert answer.status_code == 404
        assert answer.headers["cache-control"] == "no-store"


def test_they_are_small() -> None:
    assert sum(len(asset.content) for asset in assets().values()) < 60_000
