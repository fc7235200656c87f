"""The authority as a service: a process that holds the key, signs for commands, and its socket."""
