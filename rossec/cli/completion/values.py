"""Which names stand for which argument: a row for each command that takes some.

A row has the kinds of the arguments that are text, in their order. Nothing is offered for `FREE`: a
new name, a pattern, a value. Options mean the same in all commands, but for those in `_OTHERWISE`.
Pure: what a kind reads is asked of `sources.Sources`.
"""

from collections.abc import Callable, Iterator
from operator import methodcaller
from typing import Any, Final

from rossec.cli.completion import seen
from rossec.cli.completion.outline import Outline

Read = Callable[[Any], Iterator[object]]  # of `sources.Sources`

FREE: Final = "free"  # nothing to offer
COMMAND: Final = "command"

ARGUMENTS: Final[dict[str, tuple[str, ...]]] = {
    "border.state:forget": ("thing",),
    "border.things:add": (FREE,),
    "ca.enroll:enroll": (FREE,),
    "ca.identities:renew": ("recorded node",),
    "ca.identities:show": ("recorded node",),
    "ca.init:init": (FREE,),
    "ca.intermediate:request": (FREE,),
    "ca.invitations:revoke": ("invitation",),
    "ca.invite:command": (FREE,),
    "ca.requests:approve": ("request",),
    "ca.requests:deny": ("request",),
    "ca.revocation:revoke": ("recorded node or thing",),
    "ca.things:thing": ("thing",),
    "console.phones:remove": ("phone",),
    "domain.change:limit": ("domain",),
    "domain.change:remove": ("domain",),
    "domain.listing:show": ("domain",),
    "federation.sites:add": (FREE,),
    "federation.sites:param": ("domain", FREE),
    "federation.sites:remove": ("domain",),
    "grant.delivery:list_": ("node",),
    "grant.request:request": ("own node",),
    "grant.request:approve": ("grant request",),
    "grant.request:deny": ("grant request",),
    "grant.sign:sign": ("node",),
    "grant.signed_grants:revoke": ("grant",),
    "node.doctor:doctor": ("own node",),
    "node.enroll:confirm": ("own node", FREE),
    "node.enroll:enroll": ("own node",),
    "node.enroll:labels": ("own node",),
    "node.identity:code": ("own node",),
    "node.identity:request": (FREE,),
    "node.identity:show": ("own node",),
    "node.run:run": (COMMAND,),
    "node.running_nodes:info": ("running node",),
    "policy.explain:explain": ("node", "right", "topic or service"),
    "policy.opt_out:opt_out": ("node",),
    "relay.peers:add": (FREE,),
    "relay.peers:card": (FREE,),
    "relay.peers:remove": (FREE,),
    "ros.param:delete": (FREE,),
    "ros.param:get": (FREE,),
    "ros.param:list_": (FREE,),
    "ros.param:set_": (FREE, FREE),
    "ros.service:call": ("service", FREE),
    "ros.service:info": ("service",),
    "ros.service:type_": ("service",),
    "ros.topic:echo": ("topic", "message type"),
    "ros.topic:pub": ("topic", "message type", FREE),
    "ros.topic_list:find": ("message type",),
    "ros.topic_list:info": ("topic",),
    "ros.topic_list:list_": (FREE,),
    "ros.topic_list:type_": ("topic",),
    "ros.topic_rate:bw": ("topic",),
    "ros.topic_rate:hz": ("topic",),
    "router.seats:add": (FREE,),
    "router.seats:remove": (FREE,),
    "router.seats:show": (FREE,),
}

OPTIONS: Final = {
    "--as": "own node",
    "--border": "recorded node",
    "--call": "service",
    "--from-graph": "own node",
    "--graph": "node",
    "--node": "node",
    "--provide": "service",
    "--publish": "topic",
    "--replace": "thing",
    "--replace-key": "recorded node",
    "--subscribe": "topic",
    "--to": "recorded node",
    "--topic": "topic",
}
_OTHERWISE: Final = {
    ("domain.accept:accept", "--as"): FREE,
    ("federation.sites:add", "--as"): FREE,
    ("federation.sites:add", "--domain"): "domain",
    ("grant.narrow:narrow", "--as"): "own node",
    ("ros.service:call", "--type"): "service type",
}

_OWN: Final = methodcaller("own_nodes")
_WRITTEN: Final = methodcaller("written")
_NODES: Final = methodcaller("recorded", "node")
_TOPICS: Final = methodcaller("seen", seen.TOPIC)
_SERVICES: Final = methodcaller("seen", seen.SERVICE)

KINDS: Final[dict[str, tuple[Read, ...]]] = {
    FREE: (),
    COMMAND: (),
    "domain": (methodcaller("recorded", "domain"),),
    "grant": (methodcaller("recorded", "grant"), methodcaller("held_grants")),
    "grant request": (methodcaller("recorded", "grant request"),),
    "invitation": (methodcaller("recorded", "invitation"),),
    "message type": (
        methodcaller("seen", seen.TYPE),
        methodcaller("known_types"),
        methodcaller("types", "msg"),
    ),
    "node": (_OWN, _NODES, methodcaller("seen", seen.NODE), _WRITTEN),
    "own node": (_OWN,),
    "phone": (methodcaller("recorded", "phone"),),
    "recorded node": (_NODES,),
    "recorded node or thing": (_NODES, methodcaller("recorded", "thing")),
    "request": (methodcaller("recorded", "request"),),
    "right": (methodcaller("rights"),),
    "running node": (methodcaller("seen", seen.NODE),),
    "service": (_SERVICES, _WRITTEN),
    "service type": (methodcaller("types", "srv"),),
    "thing": (methodcaller("recorded", "thing"),),
    "topic": (_TOPICS, _WRITTEN),
    "topic or service": (_TOPICS, _SERVICES, _WRITTEN),
}
"""What is read for a kind, all of it together."""


def kinds_of(place: str, outline: Outline) -> list[str]:
    """The kind of each option and argument of the command at `place`, in their order."""
    arguments = iter(ARGUMENTS.get(place, ()))
    return [
        _kind_of_option(place, each["opts"]) if "opts" in each
        else next(arguments, FREE) if each.get("text")
        else FREE
        for each in outline["params"]
    ]  # fmt: skip


def _kind_of_option(place: str, opts: list[str]) -> str:
    for option in opts:
        if found := _OTHERWISE.get((place, option)) or OPTIONS.get(option):
            return found
    return FREE
