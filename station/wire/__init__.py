"""Bytes to and from a device: ports, links, commands, polled readers, frames."""
