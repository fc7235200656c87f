import asyncio
import time

import pytest

from rossec.discovery import local_links
from rossec.discovery.announcement import Candidates, DatagramSource
from rossec.errors import AnnouncementRefused, ConfigurationError
from tests.rossec.discovery.links import Link, said
from tests.support.site import Site
from tests.support.witness import until


@pytest.mark.usefixtures("link")
async def test_announcements_are_counted_and_survive_links_that_go_down(
    home: Site, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    caplog.set_level("WARNING")
    monkeypatch.setattr(Link, "takes", 0)
    credentials = home.enroll("/master").credentials()
    uri = "http://192.0.2.7:11311/"
    speaking = asyncio.ensure_future(local_links.announce(credentials, uri, version=lambda: 7, period=0.01))
    await until(lambda: said)
    Link.takes = 1
    await until(lambda: len(said) > 3)
    speaking.cancel()
    assert ["no link" in caplog.text, "the links again" in caplog.text] == [True, True]
    candidates, now = Candidates(home.anchor), int(time.time())
    heard = [candidates.heard(data, DatagramSource("fe80::1", 1), now, 1.0) for data in said[:4]]
    assert heard[0] is not None
    assert heard == [heard[0]] * 4
    assert heard[0].announcement.version == 7
    with pytest.raises(AnnouncementRefused):
        candidates.heard(said[0][:-1], DatagramSource("fe80::1", 1), now, 1.0)


async def test_a_master_that_only_this_host_reaches_is_not_announced(home: Site) -> None:
    credentials = home.enroll("/master").credentials()
    with pytest.raises(ConfigurationError, match="only this host reaches it") as caught:
        await local_links.announce(credentials, "http://127.0.0.1:11311/")
    assert "ROS_IP" in caught.value.hint
