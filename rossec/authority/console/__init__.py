"""What the authority's service does for the console: shows, denies, revokes, grants."""
