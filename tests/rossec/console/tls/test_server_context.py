import os
import socket
import ssl
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from cryptography import x509

from rossec.console.server.web import load_bundle, make_context
from rossec.console.tls.certificates import TlsAuthority
from rossec.errors import ConfigurationError
from tests.support.console_tls import NAME, NOW, bundle, foreign_leaf, new_authority, new_key, pem


def own_bundle(authority: TlsAuthority, serial: int) -> bytes:
    key = new_key()
    return bundle(authority, key, pem(authority.issue(key.public_key(), now=NOW, serial=serial)))


def shake_hands(server: ssl.SSLContext, authority: TlsAuthority, name: str) -> int:
    """Connect as a browser that trusts `authority`; returns the serial that the server showed.

    Raises:
        ssl.SSLCertVerificationError: as the browser would.
    """
    client = ssl.create_default_context(cadata=pem(authority.data).decode())
    client.verify_flags |= ssl.VERIFY_X509_STRICT
    ours, theirs = socket.socketpair()

    def serve() -> None:
        with suppress(OSError), theirs, server.wrap_socket(theirs, server_side=True) as stream:
            stream.recv(1)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        with ours, client.wrap_socket(ours, server_hostname=name) as stream:
            der = stream.getpeercert(binary_form=True)
            assert der is not None
            return x509.load_der_x509_certificate(der).serial_number
    finally:
        ours.close()
        thread.join()


@contextmanager
def serving_once(server: ssl.SSLContext) -> Iterator[int]:
    """The port of a server that shakes hands with one browser after another."""
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def serve() -> None:
            with suppress(OSError):
                while True:
                    sock, _ = listening.accept()
                    with suppress(OSError), server.wrap_socket(sock, server_side=True) as stream:
                        stream.recv(1)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield int(listening.getsockname()[1])
        listening.shutdown(socket.SHUT_RDWR)
        thread.join(10)


def test_a_renewed_bundle_is_shown_from_then_on() -> None:
    authority, server = new_authority(), make_context()
    load_bundle(server, own_bundle(authority, 5))
    assert shake_hands(server, authority, NAME) == 5
    load_bundle(server, own_bundle(authority, 6))
    assert shake_hands(server, authority, NAME) == 6


@pytest.mark.parametrize("name", ["bank.example", "other.local"])
def test_python_refuses_what_its_key_signs_for_another_name(name: str) -> None:
    authority, server, key = new_authority(), make_context(), new_key()
    leaf = foreign_leaf(authority, key, [x509.DNSName(name)])
    load_bundle(server, bundle(authority, key, leaf))
    with pytest.raises(ssl.SSLCertVerificationError, match="permitted subtree violation"):
        shake_hands(server, authority, name)


def test_python_refuses_it_under_another_name() -> None:
    authority, server = new_authority(), make_context()
    load_bundle(server, own_bundle(authority, 5))
    with pytest.raises(ssl.SSLCertVerificationError, match="Hostname mismatch"):
        shake_hands(server, authority, "other.local")


def test_old_versions_of_tls_are_not_spoken() -> None:
    assert make_context().minimum_version == ssl.TLSVersion.TLSv1_2


@pytest.mark.parametrize("data", [b"", b"nothing"])
def test_a_bundle_that_openssl_does_not_take_is_refused(data: bytes) -> None:
    with pytest.raises(ConfigurationError, match="cannot be used"):
        load_bundle(make_context(), data)


# A confined process can write no file, so it records no coverage.
UNMEASURED = {key: value for key, value in os.environ.items() if not key.startswith("COVERAGE")}
CONFINED = """
import sys
from pathlib import Path
from rossec.host.confinement import confine_files
from rossec.console.server.web import load_bundle, make_context
data = sys.stdin.buffer.read()
confine_files([Path(sys.argv[1])])
load_bundle(make_context(), data)
try:
    Path(sys.argv[2]).read_bytes()
except PermissionError:
    print("confined")
"""


def test_a_process_that_may_open_no_file_with_a_key_can_use_one(tmp_path: Path) -> None:
    inside, outside = tmp_path / "inside", tmp_path / "secret"
    inside.mkdir()
    outside.write_text("x")
    done = subprocess.run(
        [sys.executable, "-c", CONFINED, inside, outside],
        input=own_bundle(new_authority(), 1),
        capture_output=True,
        check=False,
        env=UNMEASURED,
    )
    if b"can read the files" in done.stderr:
        pytest.skip("NOT RUN: this kernel has no Landlock")
    assert (done.returncode, done.stdout) == (0, b"confined\n"), done.stderr
