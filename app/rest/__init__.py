"""The REST interface: server, checks before the routes, routes, and answers (`v1`)."""
