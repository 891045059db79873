"""Goals by topic and by action, the services that cancel them, and the client of the controller."""
