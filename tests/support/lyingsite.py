"""A master that lies to those that follow it: `python -m tests.support.lyingsite NAME LIES`.

LIES is JSON: `facts` to answer with, `flood` for so many invented ones, `list` and `entries` for
the file of a revocation list to show; it has the identity of NAME in ROSSEC_HOME.
"""

import asyncio
import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from ca.revocation.lists import MAX_AGE, Timestamp, digest, open_list, sign_timestamp
from rossec.demo.intruder import accept_any
from rossec.home import NodeHome
from rossec.net.aio import SecureStream, WireProtocol, serve
from rossec.net.rpc.calls import serve_calls
from rossec.ros.xmlrpc import Fault
from rossec.terminal import say
from tests.support.contexts import unlimited

_BATCH: Final = 1024
_PORT: Final = 11311


class LyingSite:
    """Its answers."""

    def __init__(self, home: NodeHome, lies: dict[str, Any]) -> None:
        self._home = home
        self._facts = [*lies.get("facts", []), *invented(lies.get("flood", 0))]
        self._list = Path(lies["list"]).read_bytes() if "list" in lies else b""
        self.asked = 0

    async def answer(self, method: str, params: Sequence[object]) -> object:
        match method:
            case "rossec.followSite":
                return await self._site(params[2])
            case "rossec.revocationsSince":
                return [1, "", [self._list, self._timestamp()]]
            case "rossec.presentGrants":
                return [1, "", []]
            case _:
                raise Fault(1, f"no method {method}")

    async def _site(self, cursor: object) -> object:
        at = cursor if isinstance(cursor, int) else 0
        if at >= len(self._facts) and at:
            await asyncio.sleep(5)
        facts = self._facts[at : at + _BATCH]
        self.asked += 1
        return [
            1,
            "",
            {
                "instance": "liar",
                "version": 1,
                "cursor": at + len(facts),
                "whole": at == 0,
                "more": at + len(facts) < len(self._facts),
                "added": facts,
                "removed": [],
                "revocations": digest(self._list) if self._list else b"",
                "domains": b"",
            },
        ]

    def _timestamp(self) -> bytes:
        if not self._list:
            return b""
        held = open_list(self._list, self._home.anchor().public_key)
        stamp = Timestamp(held.seq, digest(self._list), int(time.time()), MAX_AGE)
        return sign_timestamp(self._home.signer(), stamp)


def invented(count: int) -> list[list[str]]:
    """So many facts: nodes with addresses that nobody has."""
    return [
        ["node", f"/ghost{number}", f"http://10.98.7.{number % 250 + 1}:{number % 60000 + 1024}/"]
        for number in range(count)
    ]


async def main(name: str, lies: dict[str, Any]) -> None:
    home = NodeHome.of(Path(os.environ["ROSSEC_HOME"]), name)
    site = LyingSite(home, lies)

    async def handle(stream: SecureStream[Any]) -> None:
        def dispatch(method: str, params: tuple[object, ...], _peer: object) -> object:
            return site.answer(method, params)

        await serve_calls(stream, dispatch)

    context = unlimited(home.credentials(), accept_any)
    server = serve(handle, os.environ["ROS_IP"], _PORT, context, WireProtocol.HTTP)
    say(f"lying at port {server.port}")
    await asyncio.Event().wait()


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], json.loads(sys.argv[2])))
