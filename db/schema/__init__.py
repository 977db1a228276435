"""How a registry lies in its database: tables and their history, transactions, blobs, what nobody can change."""
