"""A real SoftHSM2 token in its own directory; one PKCS#11 library per process."""

import os
import subprocess
import tempfile
from functools import cache
from pathlib import Path

PIN = "739204"
MODULE = "/usr/lib/softhsm/libsofthsm2.so"


@cache
def softhsm() -> Path:
    """The directory of this process's tokens: the library reads its configuration once."""
    directory = Path(tempfile.mkdtemp(prefix="softhsm-"))
    (directory / "tokens").mkdir()
    config = directory / "softhsm2.conf"
    config.write_text(f"directories.tokendir = {directory}/tokens\nlog.level = ERROR\n")
    os.environ["SOFTHSM2_CONF"] = str(config)
    for label in ("home", "spare"):
        subprocess.run(
            [
                "softhsm2-util",
                "--init-token",
                "--free",
                "--label",
                label,
                "--pin",
                PIN,
                "--so-pin",
                "83920475",
            ],
            check=True,
            capture_output=True,
        )
    return directory
