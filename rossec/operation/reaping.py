"""The end of a child process that ends by itself; one that does not is killed."""

import asyncio
import subprocess


async def reap(process: "subprocess.Popen[bytes]", within: float) -> None:
    """Wait until `process` has ended; kill it after `within` seconds, or when this is cancelled."""
    try:
        await asyncio.to_thread(process.wait, within)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    except asyncio.CancelledError:
        process.kill()
        process.wait()
        raise
