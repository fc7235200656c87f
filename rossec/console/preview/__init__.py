"""Real messages for the pictures of the console: received as a node, kept for a minute."""
