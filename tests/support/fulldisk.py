"""`python -m tests.support.fulldisk DIRECTORY`: what each command prints when the disk is full.

Mounts a small file system at DIRECTORY, which needs a mount namespace of its own (`unshare -m`),
creates an authority and a node there, fills it to the last byte, and runs the commands. Prints
their output as JSON, and whether any file was changed.
"""

import contextlib
import gc
import io
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Final

from rossec.authority.home import AuthorityHome
from rossec.cli.main import run
from tests.support.commands import PASSPHRASE

SIZE: Final = "2m"
NOBODY: Final = ("--master", "http://127.0.0.1:1")


class Disk:
    """A small disk with an authority and the node /robot."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._filling = root / "filling"
        self._secret = root.with_name("passphrase")
        self._secret.write_text(PASSPHRASE)
        self._secret.chmod(0o600)
        AuthorityHome.create(root, "home", PASSPHRASE, int(time.time()))
        for command in (
            ("node", "request", "/robot"),
            ("ca", "sign", str(self.robot / "node.csr"), "--yes"),
            ("node", "install", str(self.robot / "node.pem"), "--yes"),
            ("node", "request", "/other"),
        ):
            code, said = self.run(*command)
            assert code == 0, said
        gc.collect()  # a database checkpoints its journal when closed

    @property
    def robot(self) -> Path:
        return self.root / "nodes" / "robot"

    def run(self, *command: str) -> tuple[int, str]:
        """Exit code, and stderr."""
        err, out = io.StringIO(), io.StringIO()
        secret = command[:2] in {("ca", "sign"), ("ca", "revoke"), ("grant", "sign")}
        more = ("--passphrase-file", str(self._secret)) if secret else ()
        environ = {**os.environ, "ROSSEC_HOME": str(self.root), "ROS_IP": "127.0.0.1"}
        with contextlib.redirect_stderr(err), contextlib.redirect_stdout(out):
            code = run([*command, *more], environ)
        return code, err.getvalue() or out.getvalue()

    def run_full(self, *command: str) -> tuple[int, str]:
        """`run` on a full disk; a database closed meanwhile may have freed space."""
        gc.collect()
        self.fill()
        return self.run(*command)

    def fill(self) -> None:
        with self._filling.open("ab", buffering=0) as file, contextlib.suppress(OSError):
            while True:
                file.write(bytes(4096))

    def make_room(self) -> None:
        self._filling.unlink()

    def state(self) -> dict[str, bytes]:
        """Every file that a command must not change."""
        return {
            str(path): path.read_bytes()
            for path in sorted(self.root.rglob("*"))
            if path.is_file() and path != self._filling and not path.name.startswith("ca.db-")
        }


def commands(disk: Disk) -> list[tuple[str, ...]]:
    return [
        ("ca", "revoke", "/robot", *NOBODY),
        ("ca", "list"),
        ("ca", "sign", str(disk.root / "nodes" / "other" / "node.csr"), "--yes"),
        ("grant", "sign", "/robot", "--publish", "/p"),
        ("node", "request", "/third"),
        ("node", "install", str(disk.robot / "node.pem"), "--yes"),
    ]


def main(root: Path) -> None:
    root.mkdir()
    options = f"size={SIZE},mode=0700"
    subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(root)], check=True)
    disk = Disk(root)
    before = disk.state()
    said = {" ".join(command[:2]): disk.run_full(*command) for command in commands(disk)}
    disk.make_room()
    after = disk.state()
    changed = [path for path in before if before[path] != after.get(path)]
    again = [disk.run("ca", "log", "verify"), disk.run("ca", "revoke", "/robot", *NOBODY)]
    new = [path for path in after if path not in before]
    print(json.dumps({"said": said, "changed": changed, "new": new, "again": again}))  # noqa: T201


if __name__ == "__main__":
    main(Path(sys.argv[1]))
