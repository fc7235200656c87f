"""The address of this host as others can reach it, for a code that they read."""

from rossec.cli.shared.context import Environment
from rossec.enrollment import address
from rossec.net.host.own_address import warn_of_own_address
from rossec.ros import settings
from rossec.terminal import note


def own_address(environment: Environment) -> str:
    """ROS_IP or ROS_HOSTNAME, else the address at which others probably reach this host."""
    configured = settings.own_address(environment.variables)
    if configured is not None:
        warn_of_own_address(
            configured, environment.variables, lambda error: note(f"{error} ({error.hint})")
        )
        return configured
    first, *others = address.own_addresses()
    if others:
        note(f"other addresses of this host, for --address: {', '.join(others)}")
    return first
