"""A lamp that can be switched, for tests of services."""

import asyncio
from typing import Any, Final

from grants.model import Restriction, filter_rules
from rossec.node import ServiceClient

LAMP: Final = "/lamp/on"
BOOL: Final = "std_srvs/SetBool"


def switch(request: Any) -> dict[str, object]:
    return {"success": True, "message": f"on is {request.data}"}


async def called(client: ServiceClient, **fields: object) -> str:
    async with asyncio.timeout(20):
        message: str = (await client(**fields)).message
        return message


def only(kind: str, *conditions: str, **filters: object) -> Restriction:
    rules = filter_rules({path: {str(op): True} for path, op in filters.items()})
    return Restriction(f"std_srvs/{kind}", conditions, rules)
