"""Who may do what: people with PINs, programs with tokens, roles of the database."""
