"""The master as a process: connections, updates, maintenance."""
