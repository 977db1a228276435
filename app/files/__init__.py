"""What softcal reads and writes on disk, a module a kind of file; bad input ends in one line."""
