"""The server's side of TLS: one context, into which renewed bundles are loaded. A shell.

The process that serves may open no file that has a key: it is given bundles (`certificates`), and
gives them to OpenSSL, which reads files alone, as a file in memory (memfd_create(2)).
"""

import os
import ssl

from rossec.errors import ConfigurationError


def make_context() -> ssl.SSLContext:
    """A context for a server that has no certificate yet: TLS 1.2 and later, HTTP/1.1."""
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.set_alpn_protocols(["http/1.1"])
    return context


def load(context: ssl.SSLContext, bundle: bytes) -> None:
    """Use `bundle` for connections from now on; those that are open keep what they have.

    Raises:
        ConfigurationError: OpenSSL cannot use it.
    """
    descriptor = os.memfd_create("tls", os.MFD_CLOEXEC)
    try:
        os.write(descriptor, bundle)
        context.load_cert_chain(f"/proc/self/fd/{descriptor}")
    except (ssl.SSLError, OSError) as error:
        raise ConfigurationError(
            f"the console's certificate cannot be used: {error}", "give another one"
        ) from error
    finally:
        os.close(descriptor)
