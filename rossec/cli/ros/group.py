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
}

_TOPIC: Final = {
    "echo": ("ros.topic:echo", "Print the messages of the topic NAME, as NODE may see them."),
    "pub": ("ros.topic:pub", "Publish CONTENT (YAML, as in rostopic) on the topic NAME."),
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
