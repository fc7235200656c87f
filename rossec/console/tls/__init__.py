"""The console's TLS: its own authority, its certificate and its renewal, files of the operator."""
