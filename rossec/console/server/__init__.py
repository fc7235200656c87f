"""The console as processes: the supervisor, the web process, and what guards its pages."""
