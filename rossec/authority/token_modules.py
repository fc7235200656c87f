"""The PKCS#11 modules that the operator of a ROSSEC_HOME trusts: code that rossec loads.

The URI of a key names a module too, but it is in `ca/`, which a backup fills: whoever made that
would name the code that is run to verify it. So a module is loaded only if it is in
`pkcs11-modules`, one absolute path a line, beside `ca/`, where nothing that is restored is written.
`rossec ca init --key` and `rossec ca restore --pkcs11-module` write it there. A home of an older
version has no such file: it was made here, unless its log says that it was restored.
"""

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import Final

from ca.errors import TokenRefused
from ca.keys.hsm import KeyUri
from rossec import files
from rossec.errors import ConfigurationError

FILE: Final = "pkcs11-modules"  # in ROSSEC_HOME
_MAX: Final = 64 * 1024


def trusted(home: Path) -> frozenset[str]:
    """The modules that were named for ROSSEC_HOME `home`; none is named without the file.

    Raises:
        PathRefused: another user could have written the file.
        ConfigurationError: it is not UTF-8.
    """
    if not exists(home):
        return frozenset()
    missing = ConfigurationError(f"there is no {FILE} any more", "do it again")
    data = files.read_own(home / FILE, _MAX, missing)
    try:
        lines = data.decode().splitlines()
    except UnicodeDecodeError:
        raise ConfigurationError(
            f"{home / FILE} is not UTF-8", "write one absolute path a line"
        ) from None
    return frozenset(line.strip() for line in lines if line.startswith("/"))


def exists(home: Path) -> bool:
    """Whether modules were named for ROSSEC_HOME `home`."""
    return (home / FILE).is_symlink() or (home / FILE).exists()


def trust(home: Path, module: str) -> None:
    """Record that the operator named `module`; durable on return.

    Raises:
        TokenRefused: not an absolute path.
        NotWritten, PathRefused: it cannot be recorded.
    """
    check_absolute(module)
    known = trusted(home)
    if module in known:
        return
    files.make_private_directory(home)
    lines = "".join(f"{each}\n" for each in sorted({*known, module}))
    files.replace(home / FILE, lines.encode())


def check_absolute(module: str) -> None:
    """Return if `module` is one file wherever a command runs.

    Raises:
        TokenRefused: it is not.
    """
    if not module.startswith("/") or not module.isprintable():
        raise TokenRefused(
            f"{module!a} is not the absolute path of a PKCS#11 module",
            "a relative one is another file in each directory: write it from the root",
        )


def require(uri: KeyUri, modules: Collection[str], home: Path) -> KeyUri:
    """Return `uri` if the operator named its module.

    Raises:
        TokenRefused: nobody but the file with the URI did.
    """
    if uri.module not in modules:
        raise TokenRefused(
            f"the key is in a token behind {uri.module!a}, a module that is not trusted here",
            f"if you know it, write its path into {home / FILE}",
        )
    return uri


def restored_uri(data: bytes, home: Path, named: str | None) -> KeyUri:
    """Where the key of a backup is, behind a module that the operator names.

    Args:
        data: `ca.uri` of the backup, which does not decide about the module.
        home: ROSSEC_HOME, whose modules are trusted.
        named: the module that the operator names for it now.

    Raises:
        TokenRefused: no URI, or the operator names no module.
    """
    uri = KeyUri.parse(data.decode(errors="replace").strip())
    if named is not None:
        check_absolute(named)
        return replace(uri, module=named)
    if uri.module not in trusted(home):
        raise TokenRefused(
            f"the key of the backup is in a token, behind the module {uri.module!a} as it says",
            "a module is code that is run: name the one to trust: --pkcs11-module /path/to.so",
        )
    return uri
