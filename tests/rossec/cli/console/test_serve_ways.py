"""Each way to get to a console, with real processes: `rossec ca serve` and `rossec console`."""

import http.client
import os
import socket
import ssl
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from urllib.parse import urlencode, urlsplit

import pytest

from rossec.cli import console as serve
from rossec.console.tls import certificates
from rossec.console.tls.certificates import key_pem, open_authority
from tests.support.commands import Shell, refused
from tests.support.console_tls import NAME, NOW, new_authority, new_key, pem
from tests.support.consolecommand import console
from tests.support.ports import free_port
from tests.support.serviceprocess import ServiceProcess


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    running = ServiceProcess(tmp_path_factory.mktemp("ways") / "home")
    running.start("--no-network", "--unlock-for", "0")
    yield running
    running.close()


def ask(
    connection: http.client.HTTPConnection,
    origin: str,
    path: str,
    form: dict[str, str] | None = None,
    **headers: str,
) -> http.client.HTTPResponse:
    given = {"Host": urlsplit(origin).netloc, "Origin": origin, **headers}
    if form is not None:
        given["Content-Type"] = "application/x-www-form-urlencoded"
    body = None if form is None else urlencode(form)
    connection.request("GET" if form is None else "POST", path, body, given)
    return connection.getresponse()


def over_tls(port: int, root: bytes, name: str = NAME) -> http.client.HTTPSConnection:
    """A browser that trusts `root` (PEM) and has found `name` at this host."""
    trust = ssl.create_default_context(cadata=root.decode())
    trust.verify_flags |= ssl.VERIFY_X509_STRICT
    connection = http.client.HTTPSConnection(name, port, timeout=30, context=trust)
    sock = socket.create_connection(("127.0.0.1", port), 30)
    connection.sock = trust.wrap_socket(sock, server_hostname=name)
    return connection


def authority_of(service: ServiceProcess) -> bytes:
    return open_authority(service.directory / certificates.DIRECTORY).data


def test_on_the_network_a_phone_that_trusts_the_authority_gets_in(service: ServiceProcess) -> None:
    port = free_port()
    with console(service, "--lan", "--name", NAME, "--port", str(port)) as running:
        origin = f"https://{NAME}:{port}"
        root = authority_of(service)
        assert running.said["ready"] == origin
        assert running.said["tls"]["words"] == certificates.in_words(root)
        with closing(over_tls(port, pem(root))) as connection:
            answer = ask(connection, origin, "/login")
            assert answer.status == 200
            assert answer.headers["Strict-Transport-Security"] is None
        with closing(over_tls(port, pem(root))) as connection:
            answer = ask(connection, origin, "/login", {"code": running.code})
            assert (answer.status, answer.headers["Location"]) == (303, "/")
            assert answer.headers["Set-Cookie"].startswith("__Host-")
        with closing(over_tls(port, pem(root))) as connection:
            assert ask(connection, f"https://127.0.0.1:{port}", "/login").status == 421
        with pytest.raises(ssl.SSLCertVerificationError):
            over_tls(port, pem(new_authority().data))


def test_the_web_process_has_no_key_of_the_authority_for_browsers(service: ServiceProcess) -> None:
    port = free_port()
    with console(service, "--lan", "--name", NAME, "--port", str(port)) as running:
        children = Path(f"/proc/{running.process.pid}/task/{running.process.pid}/children")
        key = (service.directory / certificates.DIRECTORY / certificates.KEY).read_bytes()
        for child in children.read_text().split():
            environ, command = (Path("/proc") / child / name for name in ("environ", "cmdline"))
            assert key not in environ.read_bytes() + command.read_bytes()
            names = [str(link.readlink()) for link in (Path("/proc") / child / "fd").iterdir()]
            assert not [name for name in names if "/ca/" in name]


def test_another_name_is_refused_until_it_is_meant(service: ServiceProcess) -> None:
    with console(service, "--lan", "--name", NAME, "--port", str(free_port())):
        pass
    before = authority_of(service)
    done = service.run("console", "--lan", "--name", "other.local", check=False)
    assert done.returncode == 1
    assert "phones trust this console as rossec.local" in done.stderr
    assert "--rename" in done.stderr
    assert authority_of(service) == before
    options = ("--lan", "--name", "other.local", "--rename", "--port", str(free_port()))
    with console(service, *options) as running:
        assert running.said["tls"]["name"] == "other.local"
    service.run("console", "tls", "--renew", "--name", NAME)


def test_the_certificate_is_handed_out_only_when_asked_for(service: ServiceProcess) -> None:
    with (
        console(service, "--lan", "--name", NAME, "--port", str(free_port())),
        pytest.raises(OSError, match="refused"),
    ):
        socket.create_connection(("127.0.0.1", 7410), 5)
    options = ("--lan", "--name", NAME, "--hand-out", "--port", str(free_port()))
    with console(service, *options):
        connection = http.client.HTTPConnection("127.0.0.1", 7410, timeout=30)
        with closing(connection):
            connection.request("GET", "/rossec-console.crt")
            assert connection.getresponse().read() == authority_of(service)
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("127.0.0.1", 7410), 5)


def test_the_terminal_tells_what_to_compare_and_where(service: ServiceProcess) -> None:
    port = free_port()
    command = ["console", "--lan", "--name", NAME, "--port", str(port), "--hand-out", "--log=json"]
    process = subprocess.Popen(
        [sys.executable, "-I", "-m", "rossec", *command],
        env=service.environ,
        text=True,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
    )
    try:
        assert process.stdout is not None
        said = ""
        while "Ctrl-C ends it" not in said:
            line = process.stdout.readline()
            assert line, said
            said += line
    finally:
        process.terminate()
        assert process.wait(30) == 0
        assert process.stdout is not None
        process.stdout.close()
    assert certificates.in_words(authority_of(service)) in said
    assert "http://rossec.local:7410/\n" in said
    assert "compare the fingerprint before you trust it" in said
    assert f"https://rossec.local:{port}/login#" in said
    assert "the console is at" in said


def test_a_library_that_is_missing_is_named(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serve, "find_spec", lambda name: None if name == "fido2" else name)
    refused(shell("console"), "not installed: fido2", "pip install 'rossec[console]'")


def test_certificates_of_a_real_name(service: ServiceProcess, tmp_path: Path) -> None:
    authority, key = new_authority(), new_key()
    (tmp_path / "chain.pem").write_bytes(pem(authority.issue(key.public_key(), now=NOW, serial=5)))
    (tmp_path / "key.pem").write_bytes(key_pem(key))
    port = free_port()
    files = ("--tls-cert", str(tmp_path / "chain.pem"), "--tls-key", str(tmp_path / "key.pem"))
    with console(service, *files, "--name", NAME, "--port", str(port)) as running:
        assert running.said["ready"] == f"https://{NAME}:{port}"
        assert "tls" not in running.said
        with closing(over_tls(port, pem(authority.data))) as connection:
            answer = ask(connection, f"https://{NAME}:{port}", "/login")
            assert answer.status == 200
            assert answer.headers["Strict-Transport-Security"]
    done = service.run("console", *files, "--name", "other.local", check=False)
    assert (done.returncode, "is not for other.local" in done.stderr) == (1, True)


class ProxyConnection(http.client.HTTPConnection):
    """What a proxy says to the console's unix socket."""

    def __init__(self, path: Path) -> None:
        super().__init__("localhost")
        self._path = path

    def connect(self) -> None:
        self.sock = socket.socket(socket.AF_UNIX)
        self.sock.connect(str(self._path))


def test_behind_a_proxy_its_headers_decide_nothing(service: ServiceProcess, tmp_path: Path) -> None:
    path, origin = tmp_path / "console.sock", "https://ca.example.org"
    with console(service, "--unix", str(path), "--origin", origin) as running:
        assert path.stat().st_mode & 0o777 == 0o600
        assert running.said["login"].startswith(f"{origin}/login#")
        with closing(ProxyConnection(path)) as connection:
            assert ask(connection, origin, "/login").status == 200
        forwarded = {"X-Forwarded-Host": "ca.example.org", "Forwarded": "host=ca.example.org"}
        with closing(ProxyConnection(path)) as connection:
            assert ask(connection, "https://evil.example", "/login", None, **forwarded).status == 421
        with closing(ProxyConnection(path)) as connection:
            answer = ask(
                connection,
                origin,
                "/login",
                {"code": running.code},
                Origin="https://evil.example",
                Forwarded="host=ca.example.org",
            )
            assert answer.status == 403
        with closing(ProxyConnection(path)) as connection:
            assert ask(connection, origin, "/login", {"code": running.code}).status == 303
    assert not path.exists()


AS_ANOTHER_USER = """
import os, socket, sys
os.setgid(2)
os.setuid(2)
sock = socket.socket(socket.AF_UNIX)
sock.connect(sys.argv[1])
sock.sendall(b"GET /login HTTP/1.1\\r\\nHost: a.example\\r\\n\\r\\n")
sys.stdout.write(repr(sock.recv(100)))
"""


@pytest.mark.skipif(os.geteuid() != 0, reason="NOT RUN: needs root, to be another user")
def test_a_user_that_is_no_proxy_gets_nothing(service: ServiceProcess) -> None:
    """The proxy's user is another one, so this one's program is cut off, unless it is the own."""
    with tempfile.TemporaryDirectory() as directory:
        Path(directory).chmod(0o755)
        path = Path(directory) / "console.sock"
        options = ("--unix", str(path), "--origin", "https://a.example", "--proxy-user", "nobody")
        with console(service, *options):
            assert path.stat().st_mode & 0o777 == 0o666
            done = subprocess.run(
                [sys.executable, "-c", AS_ANOTHER_USER, str(path)],
                capture_output=True,
                text=True,
                check=False,
            )
        errors = ("ConnectionResetError", "BrokenPipeError")
        assert done.stdout == "b''" or any(name in done.stderr for name in errors), done.stderr
    done_user = service.run(*(("console", *options[:-1], "no-such-user")), check=False)
    assert "there is no user 'no-such-user'" in done_user.stderr


def test_a_screen_on_the_wall_has_nothing_but_looking(service: ServiceProcess) -> None:
    port = free_port()
    with console(service, "--read-only", "--port", str(port)) as running:
        origin = running.said["ready"]

        def post(path: str, form: dict[str, str], cookie: str = "") -> int:
            more = {"Cookie": cookie} if cookie else {}
            with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=30)) as connection:
                return ask(connection, origin, path, form, **more).status

        with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=30)) as connection:
            answer = ask(connection, origin, "/login", {"code": running.code})
            assert answer.status == 303
            cookie = answer.headers["Set-Cookie"].partition(";")[0]
        with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=30)) as connection:
            answer = ask(connection, origin, "/", Cookie=cookie)
            assert answer.status == 200
            assert b'method="post"' not in answer.read()
        for path in (
            "/prepare/grant",
            "/add",
            "/phones/link",
            "/login/new",
            "/login/phone",
            "/revoke/node//master",
            "/invite/AA/end",
            "/propose",
        ):
            assert post(path, {"reason": "x"}, cookie) in {404, 405}
        assert not (service.directory / "console" / "address").exists()


def test_phones_of_another_address_stop_the_start(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serve, "origins_of_phones", lambda _: {"http://localhost:7411"})
    refused(shell("console", "--port", "7412"), "cannot approve at http://localhost:7412")
    refused(shell("console", "--port", "7412", "--rename"), "the authority's service does not run")


def test_options_are_checked_before_anything_is_made(shell: Shell) -> None:
    refused(shell("console", "--lan", "--name", "192.168.1.5"), "a passkey cannot belong to one")
    refused(shell("console", "--unix", "/tmp/x"), "needs both --unix and --origin")
    assert not (shell.root / "ca" / "console").exists()
