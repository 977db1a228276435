"""Bytes to and from a device: ports, links, polled readers, frames."""
