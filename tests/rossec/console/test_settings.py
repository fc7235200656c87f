"""A console's settings, and what follows from them."""

from rossec.console.server.control import WebSettings, read_settings, write_settings

OWN = WebSettings("home", ("http://localhost:7411",), users=frozenset({2, 1}))


def test_what_follows_from_the_origin() -> None:
    assert (OWN.origin, OWN.rp_id) == ("http://localhost:7411", "localhost")
    assert OWN.hosts == {"localhost:7411"}
    far = WebSettings("home", ("https://ca.example.org",))
    assert far.rp_id == "ca.example.org"
    assert far.hosts == {"ca.example.org"}


def test_they_are_written_and_read() -> None:
    others = WebSettings("home", ("https://a", "https://b"), None, True, True, 1, 2)
    proxy = WebSettings("home", ("https://a",), proxy_users=frozenset({0, 33}))
    for settings in (OWN, others, proxy):
        assert read_settings(write_settings(settings)) == settings
