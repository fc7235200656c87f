import pytest

from rossec.errors import ConfigurationError
from rossec.federation.settings import FederationConfig, SiteSettings, read_config
from rossec.master.operation.config import parse


def read(text: str) -> FederationConfig:
    return read_config(parse(text, "m.yaml").federation, "m.yaml")


def test_sites_in_the_configuration() -> None:
    found = read(
        "port: 11311\n"
        "federation:\n"
        "  follow_announced: true\n"
        "  sites:\n"
        "    kitchen: {uri: 'http://kitchen:11311', master: /master/kitchen,"
        " parameters: [/robot/**]}\n"
        "    hospital: {uri: 'http://h:11311', domain: hospital}\n"
        "    office: {via: ward, master: /master/office}\n"
    )
    assert found.follow_announced
    assert found.sites == (
        SiteSettings("kitchen", "http://kitchen:11311", "/master/kitchen", "", ("/robot/**",)),
        SiteSettings("hospital", "http://h:11311", domain="hospital"),
        SiteSettings("office", "", "/master/office", via="ward"),
    )


@pytest.mark.parametrize("text", ["", "port: 1", "federation:\n  sites: {}\n"])
def test_nothing_is_followed_by_default(text: str) -> None:
    assert read(text) == FederationConfig()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("federation: 1", r"m.yaml:1: federation is a map"),
        ("federation:\n  follow: true", r"m.yaml:2: federation has no 'follow'"),
        ("federation:\n  follow_announced: yes", r"m.yaml:2: follow_announced is true or false"),
        ("federation:\n  sites: [a]", r"m.yaml:2: sites is a map"),
        ("federation:\n  sites:\n    a: 1", r"m.yaml:3: site a is a map"),
        ("federation:\n  sites:\n    a: {}", r"m.yaml:3: site 'a' has no uri"),
        ("federation:\n  sites:\n    a: {uri: 'http://h:1', via: b}", r"a URI or a relay's peer"),
        ("federation:\n  sites:\n    a: {via: [b]}", r"m.yaml:3: via is a text"),
        ("federation:\n  sites:\n    a: {url: x}", r"m.yaml:3: site a has no 'url'"),
        ("federation:\n  sites:\n    a: {uri: 5}", r"m.yaml:3: uri is a text"),
        ("federation:\n  sites:\n    a: {uri: kitchen}", r"m.yaml:3: .*URI"),
        ("federation:\n  sites:\n    a: {uri: 'http://h:1', parameters: /a}", r"is a list of"),
        ("federation:\n  sites:\n    a: {uri: 'http://h:1', parameters: [[]]}", r"is a text"),
        (
            "federation:\n  sites:\n    a: {uri: 'http://h:1'}\n    b: {uri: 'http://h:2'}",
            r"m.yaml: a and b are one master",
        ),
    ],
)
def test_mistakes_name_their_line(text: str, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        read(text)
