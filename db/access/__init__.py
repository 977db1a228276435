"""Access control: people with PINs, programs with tokens, roles of the database."""
