"""Which certificates an endpoint shows, checked before anything listens. A shell."""

from pathlib import Path
from typing import NamedTuple

from rossec.console.options import Endpoint, Tls
from rossec.console.tls import store
from rossec.console.tls.authority import TlsAuthority
from rossec.console.tls.certificates import CertificateSource, FileCertificates, OwnCertificates
from rossec.errors import ConfigurationError


class TlsSetup(NamedTuple):
    """Where certificates come from; `authority` if they are of the console's own one."""

    source: CertificateSource
    authority: TlsAuthority | None = None


def prepare_tls(endpoint: Endpoint, directory: Path, now: int, *, rename: bool) -> TlsSetup | None:
    """The certificates of `endpoint`; None: it does without.

    Args:
        endpoint: of the console.
        directory: the console's own; its TLS authority is made there when it is needed first.
        now: seconds since the epoch.
        rename: replace an authority that is for another name.

    Raises:
        ConfigurationError: a certificate cannot be used; the message says why.
    """
    if endpoint.tls is Tls.NONE:
        return None
    if endpoint.tls is Tls.OWN:
        host = store.first_address()
        authority = store.authority_for(directory, endpoint.name, host, now, rename=rename)
        return TlsSetup(OwnCertificates(authority, host, store.random_serial), authority)
    if endpoint.tls_certificate is None or endpoint.tls_key is None:
        raise ConfigurationError("a certificate needs its key", "give --tls-cert and --tls-key")
    files = FileCertificates(endpoint.tls_certificate, endpoint.tls_key, endpoint.name)
    files.first(now)
    return TlsSetup(files)
