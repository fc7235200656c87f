"""What every long-running program of rossec shares: audit, lock, signals, its service manager."""
