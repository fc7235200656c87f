"""The console's TLS: its own authority, its certificate and its renewal, files of the operator.

`hand_out`, which needs a web server, is imported when it is used.
"""

from rossec.console.tls.certificates import (
    DIRECTORY,
    TlsAuthority,
    TlsSetup,
    as_json,
    describe,
    prepare_tls,
    renewed_from,
)

__all__ = ["DIRECTORY", "TlsAuthority", "TlsSetup", "as_json", "describe", "prepare_tls", "renewed_from"]
