"""How a registry lies in its database: tables, transactions, blobs, what nobody can change."""
