"""The master as a process: connections, updates, maintenance."""

from rossec.master.server.effects import DenialLog, Effects, MasterState, ignore_denial
from rossec.master.server.server import MasterServer, master_of

__all__ = ["DenialLog", "Effects", "MasterServer", "MasterState", "ignore_denial", "master_of"]
