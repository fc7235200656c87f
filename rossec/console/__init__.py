"""The console: pages for the person who lives with the robots."""
