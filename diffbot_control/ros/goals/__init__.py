"""Goals from outside: topics, services, actions, files."""
