"""Calls to a master at which a victim is registered."""

from typing import Any

from grants.model import Right
from rossec.master.api.dispatch import MasterApi
from rossec.master.rights.caller import Caller
from tests.rossec.master.fakes import ALL, call_api

BUT_ADMIN = {"/**": ALL & ~Right.ADMIN}
T = "std_msgs/String"
VICTIM_API, EVIL_API = "http://victim:1/", "http://evil:1/"


def ask(api: MasterApi, who: Caller, method: str, *params: object) -> Any:
    return call_api(api, method, params, who, 0).answer
