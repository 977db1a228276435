"""Schema of a registry: tables, transactions, blobs, protection against changes."""
