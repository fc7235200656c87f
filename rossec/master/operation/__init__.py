"""The master as a service: configuration, limits, denials, metrics, administration."""

from rossec.master.operation.admin import (
    DENIALS,
    AdminPort,
    denials_limited,
    raise_descriptor_limit,
    send_command,
)
from rossec.master.operation.config import Config, MasterLimits
from rossec.master.operation.metrics import MetricsExporter, on_loop

__all__ = [
    "DENIALS",
    "AdminPort",
    "Config",
    "MasterLimits",
    "MetricsExporter",
    "denials_limited",
    "on_loop",
    "raise_descriptor_limit",
    "send_command",
]
