"""What a relay tells Zenoh, and that Zenoh knows each of these settings."""

import base64
import json

import pytest
import zenoh
from cryptography.hazmat.primitives.asymmetric import ec

from rossec.overlay.documents import Routers
from rossec.overlay.router_settings import COMMON, client_settings
from rossec.overlay.router_tls import RouterAuthority
from tests.support.pki import NOW

PASSWORD = "x" * 22


def applied(settings: dict[str, object]) -> zenoh.Config:
    config = zenoh.Config()
    for path, value in settings.items():
        config.insert_json5(path, json.dumps(value))
    return config


@pytest.mark.parametrize("path", sorted(COMMON))
def test_zenoh_takes_every_setting(path: str) -> None:
    value = COMMON[path]
    assert json.loads(applied({path: value}).get_json(path)) == value


def test_a_relay_listens_nowhere_and_is_a_client() -> None:
    routers = Routers(("tcp/192.0.2.1:7447", "tcp/192.0.2.2:7447"), "open")
    config = applied(client_settings(routers))
    assert json.loads(config.get_json("mode")) == "client"
    assert json.loads(config.get_json("listen/endpoints")) == []
    assert json.loads(config.get_json("connect/endpoints")) == list(routers.locators)
    assert json.loads(config.get_json("transport/auth/usrpwd/user")) is None
    assert json.loads(config.get_json("transport/link/tls/root_ca_certificate_base64")) is None


def test_the_account_and_the_authority_of_the_routers_are_told() -> None:
    key = ec.generate_private_key(ec.SECP256R1())
    root = RouterAuthority.create(key, now=NOW, serial=7).pem.decode()
    routers = Routers(("tls/192.0.2.1:7447",), "ward", PASSWORD, root)
    config = applied(client_settings(routers))
    assert json.loads(config.get_json("transport/auth/usrpwd/user")) == "ward"
    tls = "transport/link/tls/"
    assert json.loads(config.get_json(f"{tls}verify_name_on_connect")) is True
    settings = client_settings(routers)
    told = settings[f"{tls}root_ca_certificate_base64"]
    assert isinstance(told, str)
    assert base64.b64decode(told).decode() == root
    assert settings["transport/auth/usrpwd/password"] == PASSWORD
