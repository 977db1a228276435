"""Tables as loggers and laboratories write them, into named columns; every entry point reads through here."""
