"""`rossec console --lan` in a browser that trusts the console's own TLS authority."""

import shutil
import socket
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import uvicorn
from cryptography import x509
from playwright.sync_api import Error
from starlette.types import ASGIApp

from rossec.console.server.web import load_bundle, make_context
from rossec.console.tls.certificates import DIRECTORY, open_authority
from rossec.console.tls.hand_out import create_hand_out
from tests.rossec.console.tls.test_server_context import serving_once
from tests.support.browser import Chromium, running_chromium
from tests.support.console_tls import NAME, bundle, foreign_leaf, new_authority, new_key, pem
from tests.support.consolecommand import console
from tests.support.pagecheck import PageCheck
from tests.support.ports import free_port
from tests.support.serviceprocess import ServiceProcess

pytestmark = pytest.mark.browser
BANK = "bank.example"
HERE = f"--host-resolver-rules=MAP {NAME} 127.0.0.1,MAP {BANK} 127.0.0.1"


@pytest.fixture
def service(tmp_path: Path) -> Iterator[ServiceProcess]:
    running = ServiceProcess(tmp_path / "home")
    running.start("--no-network", "--unlock-for", "0")
    yield running
    running.close()


def trust(home: Path, root: bytes) -> None:
    """Have Chromium trust `root` (PEM), as a person who imports it as an authority."""
    if shutil.which("certutil") is None:
        pytest.skip("NOT RUN: certutil of libnss3-tools is not installed")
    database = home / ".pki" / "nssdb"
    database.mkdir(parents=True)
    place = ("-d", f"sql:{database}")
    subprocess.run(["certutil", *place, "-N", "--empty-password"], check=True)
    given = ("-n", "rossec console", "-t", "C,,")
    subprocess.run(["certutil", *place, "-A", *given], input=root, check=True)


def test_a_browser_that_trusts_it_opens_the_console_and_no_other_site(
    service: ServiceProcess, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = ("--lan", "--name", NAME, "--port", str(free_port()))
    with console(service, *options) as running:
        origin = running.said["ready"]
        authority = open_authority(service.directory / DIRECTORY)
        with (
            running_chromium(tmp_path, HERE) as stranger,
            stranger.window(origin, checked=False) as window,
            pytest.raises(Error, match="ERR_CERT_AUTHORITY_INVALID"),
        ):
            window.open("/login")
        trust(tmp_path / "person", pem(authority.data))
        monkeypatch.setenv("HOME", str(tmp_path / "person"))
        with running_chromium(tmp_path, HERE) as chromium:
            with chromium.window(origin) as window:
                page = window.open(f"/login#{running.code}")
                page.get_by_role("button", name="Set up this phone").click()
                page.wait_for_url(f"{origin}/")
                assert len(window.passkeys()) == 1
                assert window.passkeys()[0]["rpId"] == NAME
                # ES256 alone is taken, which every phone has; Chromium would like RS256 too.
                window.faults = [each for each in window.faults if "RS256" not in each]
            key, server = new_key(), make_context()
            leaf = foreign_leaf(authority, key, [x509.DNSName(BANK)])
            load_bundle(server, bundle(authority, key, leaf))
            with (
                serving_once(server) as port,
                chromium.window(f"https://{BANK}:{port}", checked=False) as window,
                pytest.raises(Error, match="ERR_CERT_INVALID"),
            ):
                window.open("/")


@contextmanager
def serving(app: ASGIApp) -> Iterator[str]:
    """The application at a port of localhost; its origin."""
    server = uvicorn.Server(uvicorn.Config(app, log_level="error", lifespan="off"))
    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        try:
            yield f"http://127.0.0.1:{listener.getsockname()[1]}"
        finally:
            server.should_exit = True
            thread.join()


def test_the_page_that_hands_the_certificate_out_is_sound(chromium: Chromium, check: PageCheck) -> None:
    authority = new_authority()
    app = create_hand_out(authority.data, f"https://{NAME}:7411", lambda: False)
    with serving(app) as origin, chromium.window(origin) as window:
        window.open("/")
        check(window, "lan-hand-out", "phone", "phone-dark")
        with window.page.expect_download() as download:
            window.page.locator("a[href$='.crt']").first.click()
        assert download.value.path().read_bytes() == authority.data
