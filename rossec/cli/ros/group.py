"""The groups `rossec param`, `rossec service` and `rossec topic`."""

from typing import Final

import click

from rossec.cli.shared.lazy import LazyGroup

_PARAM: Final = {
    "delete": ("ros.param:delete", "Unset the parameter NAME and everything below it."),
    "get": ("ros.param:get", "Print the parameter NAME, or a namespace with all in it."),
    "list": (
        "ros.param:list_",
        "List the parameters that NODE may read, of all or of one NAMESPACE.",
    ),
    "set": ("ros.param:set_", "Set the parameter NAME to VALUE (YAML, as in rosparam)."),
}

_SERVICE: Final = {
    "call": (
        "ros.service:call",
        "Call the service NAME with CONTENT (YAML, as in rosservice) and print the answer.",
    ),
    "info": (
        "ros.service:info",
        "Show which node provides the service NAME, where, and its type.",
    ),
    "list": ("ros.service:list_", "List the services that NODE may see."),
    "type": ("ros.service:type_", "Print the type of the service NAME."),
}

_TOPIC: Final = {
    "bw": (
        "ros.topic_rate:bw",
        "Show how many bytes of the topic NAME arrive, as NODE may see them.",
    ),
    "echo": ("ros.topic:echo", "Print the messages of the topic NAME, as NODE may see them."),
    "find": ("ros.topic_list:find", "List the topics whose messages are of TYPE."),
    "hz": (
        "ros.topic_rate:hz",
        "Show how often messages of the topic NAME arrive, as NODE may see them.",
    ),
    "info": (
        "ros.topic_list:info",
        "Show the type of the topic NAME and the nodes that publish and subscribe to it.",
    ),
    "list": (
        "ros.topic_list:list_",
        "List the topics that NODE may see, all or those below NAMESPACE.",
    ),
    "pub": ("ros.topic:pub", "Publish CONTENT (YAML, as in rostopic) on the topic NAME."),
    "type": ("ros.topic_list:type_", "Print the type of the topic NAME."),
}


@click.group(cls=LazyGroup, table=_PARAM)
def param() -> None:
    """Read and write parameters."""


@click.group(cls=LazyGroup, table=_SERVICE)
def service() -> None:
    """List, ask and call services."""


@click.group(cls=LazyGroup, table=_TOPIC)
def topic() -> None:
    """Publish and listen."""
