"""Names by rules where they are used: in launch files, and asked for by nodes."""
