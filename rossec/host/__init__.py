"""What every long-running program of rossec shares: audit, lock, signals, its service manager.

The process at the other end of a local socket, as Linux knows it.
"""
