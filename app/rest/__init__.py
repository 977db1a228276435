"""The REST interface: its server, what stands before it, its routes, and its answers (`v1`)."""
